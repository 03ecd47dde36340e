"""Names of ports that an option lists."""

from collections.abc import Sequence


def mistakes(names: Sequence[str], owner: str) -> list[str]:
    """Return what is wrong with the names of the inputs of "a bus", say: none at all, or one twice."""
    if not names:
        return [f"names is empty: {owner} needs at least one input"]
    return [f"name '{name}' is given twice" for name in dict.fromkeys(names) if names.count(name) > 1]
