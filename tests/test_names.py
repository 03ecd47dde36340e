"""A name means one thing in the whole package."""

import ast
from collections import defaultdict
from pathlib import Path

import rotorsim

ROOM = Path(rotorsim.__file__).parent


def test_a_constant_of_one_name_has_one_value():
    values = defaultdict(lambda: defaultdict(list))
    for file in ROOM.rglob("*.py"):
        for statement in ast.parse(file.read_text(encoding="utf-8")).body:
            match statement:
                case ast.Assign(targets=[ast.Name(id=name)], value=value) if name.isupper() and name[0] != "_":
                    values[name][ast.unparse(value)].append(str(file.relative_to(ROOM)))
                case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value) if name.isupper():
                    values[name][ast.unparse(value)].append(str(file.relative_to(ROOM)))
    assert {name: dict(by_value) for name, by_value in values.items() if len(by_value) > 1} == {}
