"""Arrays of compiled code whose references nobody counts.

Numba counts a reference to each array of a tuple that a function takes or looks into, atomically; in steps of
small nets that is half of the time. A function that is called from Python may borrow its arguments instead:
their owner waits for it. And it takes each array of a tuple out of its Python object, 0.1 us a call, if
they are no `HeldTuple`.

Importing this module imports Numba, so only compiled code and what makes it may do so.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
# (Numba demands the overloads' signatures without annotations.)

from __future__ import annotations

from typing import Any

from numba.core import cgutils, types
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate
from numba.experimental import structref
from numba.extending import infer_getattr, models, register_model
from numba.extending import intrinsic as _typed_intrinsic

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
    kind = borrowed_kind(value)
    return kind(value), lambda context, builder, signature, args: args[0]  # the same words in memory


def borrowed_kind(kind: types.Type) -> types.Type:
    """The type of a borrowed value of this type."""
    if isinstance(kind, types.Array):
        return Borrowed(kind.dtype, kind.ndim, kind.layout)
    if isinstance(kind, types.BaseTuple):
        parts = [borrowed_kind(one) for one in kind]  # type: ignore[attr-defined]
        return types.BaseTuple.from_types(parts, getattr(kind, "instance_class", None))
    if isinstance(kind, HeldTupleType):
        return Loan(borrowed_kind(kind.field_dict["value"]))  # type: ignore[arg-type]
    return kind


@structref.register
class HeldTupleType(types.StructRef):
    """The compiler's type of a `HeldTuple`."""


class HeldTuple(structref.StructRefProxy):
    """A tuple of tuples and arrays in the memory of compiled code, which makes it: one object for Python."""


structref.define_proxy(HeldTuple, HeldTupleType, ["value"])


class Loan(types.Type):
    """A borrowed `HeldTuple`: its tuple stays where it is, and has its fields as attributes.

    What passes on a tuple passes on each word of its arrays, and takes the longer to compile, the more there
    are: a large one is better held.
    """

    def __init__(self, kind: types.BaseTuple) -> None:
        self.kind = kind
        super().__init__(name=f"Loan({kind})")


@register_model(Loan)
class _LoanModel(models.StructModel):
    """The words of a `HeldTuple`."""

    def __init__(self, manager: Any, kind: Loan) -> None:
        super().__init__(manager, kind, [("meminfo", types.voidptr)])


@infer_getattr
class _LoanFields(AttributeTemplate):
    key = Loan

    def generic_resolve(self, value: Any, attr: Any) -> Any:  # type: ignore[override]
        """The type of a field."""
        fields: Any = getattr(value.kind, "fields", ())
        return value.kind.types[fields.index(attr)] if attr in fields else None


@lower_getattr_generic(Loan)
def _load_field(context: Any, builder: Any, loan: Loan, value: Any, name: str) -> Any:
    words = cgutils.create_struct_proxy(loan)(context, builder, value=value)
    data = context.nrt.meminfo_data(builder, words.meminfo)
    held = context.get_value_type(loan.kind)  # the only field of what is held
    number = loan.kind.fields.index(name)  # type: ignore[attr-defined]
    return builder.load(cgutils.gep_inbounds(builder, builder.bitcast(data, held.as_pointer()), 0, number))
