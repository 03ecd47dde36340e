"""``python -m rotorsim`` is the command ``rotorsim``."""

from rotorsim.cli.app import main

if __name__ == "__main__":
    main()
