"""What griffe leaves out of docstrings is put back, so that the reference has it."""

from typing import Any

import griffe


class Completed(griffe.Extension):
    """Types and defaults of parameters, and inherited attributes; griffe calls the methods by these names."""

    def on_function(self, *, func: griffe.Function, **_: Any) -> None:
        """Give parameters that share a line, "tile, method" say, each its own; griffe has the first one's for all."""
        for parameter in func.parameters:
            if isinstance(parameter.default, griffe.ExprName):  # of a constant its value
                constant = func.modules_collection[parameter.default.canonical_path]
                parameter.default = getattr(constant, "value", parameter.default)
        _complete(func)

    def on_class(self, *, cls: griffe.Class, **_: Any) -> None:
        """Complete the parameters likewise, and put the attributes of the bases before those of the class."""
        _complete(cls)
        for base in cls.mro():
            for own in _sections(cls, griffe.DocstringSectionAttributes):
                names = {attribute.name for attribute in own.value}
                for section in _sections(base, griffe.DocstringSectionAttributes):
                    own.value[:0] = [attribute for attribute in section.value if attribute.name not in names]


def _complete(described: griffe.Function | griffe.Class) -> None:
    """Give the parameters in a docstring the types and defaults of the signature."""
    signature = {parameter.name: parameter for parameter in described.parameters}
    for section in _sections(described, griffe.DocstringSectionParameters):
        for parameter in section.value:
            if own := signature.get(parameter.name):
                parameter.value = own.default
                if any(parameter.annotation is other.annotation for other in signature.values()):
                    parameter.annotation = own.annotation


def _sections(described: griffe.Object, kind: type[griffe.DocstringSection]) -> list[Any]:
    parsed = described.docstring.parsed if described.docstring else []
    return [section for section in parsed if isinstance(section, kind)]
