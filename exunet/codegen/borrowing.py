"""Arrays of compiled code whose references nobody counts.

Numba counts a reference to each array of a tuple that a function takes or looks into, atomically; in steps of
small nets that is half of the time. A function that is called from Python may borrow its arguments instead:
their owner waits for it. And it takes each array of a tuple out of its Python object, 0.1 us a call, if
they are not `Held`.

Importing this module imports Numba, so only compiled code and what makes it may do so.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
# (Numba demands the overloads' signatures without annotations.)

from __future__ import annotations

from typing import Any

from numba.core import types
from numba.experimental import structref
from numba.extending import intrinsic as _typed_intrinsic
from numba.extending import models, register_model

intrinsic: Any = _typed_intrinsic  # its stub does not know that the compiler passes the first argument


class Borrowed(types.Array):
    """An array whose references nobody counts."""

    def __init__(self, dtype: types.Type, ndim: int, layout: Any) -> None:
        super().__init__(dtype, ndim, layout, aligned=False, name=f"Borrowed({dtype}, {ndim}, {layout})")

    def copy(self, dtype: Any = None, ndim: Any = None, layout: Any = None, readonly: Any = None) -> Any:
        """The type of a part of such an array."""
        return Borrowed(dtype or self.dtype, self.ndim if ndim is None else ndim, layout or self.layout)


@register_model(Borrowed)
class _BorrowedModel(models.StructModel):
    """As Numba's own, but for the type of `meminfo`, from which it knows what to count."""

    def __init__(self, manager: Any, kind: Borrowed) -> None:
        own = models.ArrayModel(manager, kind)
        fields = [(name, own.get_type(name)) for name in own._fields]
        super().__init__(manager, kind, [("meminfo", types.voidptr), *fields[1:]])


@intrinsic
def borrowed(typingctx: Any, value: Any) -> Any:
    """An array, or a tuple of tuples and arrays, that must not outlive the one given; in compiled code."""
    kind = _borrowed(value)
    return kind(value), lambda context, builder, signature, args: args[0]  # the same words in memory


def _borrowed(kind: types.Type) -> types.Type:
    if isinstance(kind, types.Array):
        return Borrowed(kind.dtype, kind.ndim, kind.layout)
    if isinstance(kind, types.BaseTuple):
        parts = [_borrowed(one) for one in kind]  # type: ignore[attr-defined]
        return types.BaseTuple.from_types(parts, getattr(kind, "instance_class", None))
    return kind


@structref.register
class HeldType(types.StructRef):
    """The compiler's type of a `Held`."""


class Held(structref.StructRefProxy):
    """A tuple of tuples and arrays in the memory of compiled code, which makes it: one object for Python."""


structref.define_proxy(Held, HeldType, ["value"])
