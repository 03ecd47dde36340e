"""What keeps tests cheap: one thread of linear algebra, and no search for garbage in what pytest itself holds."""

import gc
import os

# For their many small matrices two threads cost several times the CPU of one. Read where numpy is first imported, and
# inherited by the commands that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
gc.disable()


def pytest_collection_finish() -> None:
    gc.enable()
    gc.freeze()
