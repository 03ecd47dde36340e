"""To file: signals to record in a file of their own."""

from pathlib import PurePosixPath

from rotorsim.blocks.common import names as naming

from rotorsim.block import Block, Equations, In, Option

_ENDINGS = (".csv", ".h5", ".npz")


class ToFile(Block):
    """Mark signals of any shape to be recorded in a file of their own.

    It has no output and changes nothing. The file lies inside the folder of the diagram; its ending says the format.
    """

    source = "thesis Figures 2-5, 3-2, 4-4, 5-3 (to workspace); Simulink: To File, To Workspace"

    input = In(shape="signal*", unit=None, many="names", doc="one port for each name, of any shape")
    names = Option(["input"], kind=str, doc="names of the input ports; the names of the columns")
    file = Option("signals.csv", kind=str, doc="file name ending in .csv, .h5 or .npz, relative to the diagram")

    def check(self, values):
        """Refuse missing and repeated names, other formats, and files outside the folder of the diagram."""
        file = self.option.file
        messages = naming.mistakes(self.option.names, "a file")
        if not file.endswith(_ENDINGS) or file in _ENDINGS:
            messages.append(f"file '{file}' must end in one of {', '.join(_ENDINGS)}")
        path = PurePosixPath(file)
        if path.is_absolute() or ".." in path.parts or "\\" in file or ":" in file:
            messages.append(f"file '{file}' must be a relative name inside the folder of the diagram")
        return messages

    def equations(self, p, u, x, t):
        return Equations()
