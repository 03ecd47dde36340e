"""Block library; every file defines one block, in folders by category."""
