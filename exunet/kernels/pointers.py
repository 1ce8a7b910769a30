"""Numba types and intrinsics: arrays without reference counts, calls and data by address.

Numba counts a reference to each array of a tuple that a function takes or reads, atomically: half of the
time of a step of small nets. A function that is called from Python may borrow its arguments instead, since
their owner waits for it. It also unboxes each array of a tuple, 0.1 us a call, unless they are held in a
`HeldTuple`.

The steps of the compiled loop and the functions of each kind of force are compiled apart. The steps call by
address, so that they are compiled once for all scenes, and a force once for all sets of forces. A call costs
some nanoseconds.

Importing this module imports Numba: only compiled code and what builds it may do so.
"""

from __future__ import annotations

import inspect
import operator
from typing import Any

from numba.core import cgutils, errors, types
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate
from numba.experimental import structref
from numba.extending import infer_getattr, lower_builtin, models, register_model
from numba.extending import intrinsic as _typed_intrinsic
from numba.np import arrayobj

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls
# (Numba demands the overloads' signatures without annotations.)


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


# Numba's own functions for items put each array into memory first: twice as much code to compile.


def _item_at(context: Any, builder: Any, kind: Borrowed, array: Any, index: types.Type, value: Any) -> Any:
    """Where an item stands; None for what is no item, or not of a contiguous array."""
    if isinstance(index, types.BaseTuple):
        kinds, values = index.types, cgutils.unpack_tuple(builder, value)  # type: ignore[attr-defined]
    else:
        kinds, values = (index,), (value,)
    of_integers = all(isinstance(item, types.Integer) for item in kinds)
    if kind.layout != "C" or len(kinds) != kind.ndim or not of_integers:
        return None
    model = context.data_model_manager[kind]
    sizes, offset = model.get(builder, array, "shape"), None
    for axis, (item, number) in enumerate(zip(kinds, values, strict=True)):
        size = builder.extract_value(sizes, axis)
        own = arrayobj.fix_integer_index(context, builder, item, number, size)
        offset = own if offset is None else builder.add(builder.mul(offset, size), own)
    return builder.gep(model.get(builder, array, "data"), [offset], inbounds=True)


@lower_builtin(operator.getitem, Borrowed, types.Integer)
@lower_builtin(operator.getitem, Borrowed, types.BaseTuple)
def _get_item(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    kind, index = signature.args
    place = _item_at(context, builder, kind, args[0], index, args[1])
    if place is not None:
        return arrayobj.load_item(context, builder, kind, place)
    of_tuple = isinstance(index, types.BaseTuple)
    other = arrayobj.getitem_array_tuple if of_tuple else arrayobj.getitem_arraynd_intp
    return other(context, builder, signature, args)


@lower_builtin(operator.setitem, Borrowed, types.Any, types.Any)
def _set_item(context: Any, builder: Any, signature: Any, args: Any) -> None:
    kind, index, given = signature.args
    place = _item_at(context, builder, kind, args[0], index, args[1])
    if place is None:
        arrayobj.setitem_array(context, builder, signature, args)
    else:
        value = context.cast(builder, args[2], given, kind.dtype)
        arrayobj.store_item(context, builder, kind, value, place)


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
        parts = [borrowed_kind(item) for item in kind]  # type: ignore[attr-defined]
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
def _load_loan_field(context: Any, builder: Any, loan: Loan, value: Any, name: str) -> Any:
    words = cgutils.create_struct_proxy(loan)(context, builder, value=value)
    data = context.nrt.meminfo_data(builder, words.meminfo)
    held = context.get_value_type(loan.kind)  # the only field of what is held
    number = loan.kind.fields.index(name)  # type: ignore[attr-defined]
    return builder.load(cgutils.gep_inbounds(builder, builder.bitcast(data, held.as_pointer()), 0, number))


class At(types.Type):
    """Where a named tuple of arrays and numbers stands in memory; its fields are attributes."""

    def __init__(self, kind: types.BaseTuple) -> None:
        self.kind = kind
        super().__init__(name=f"At({kind})")


class Anywhere(types.Type):
    """An `At` whose tuple the caller does not know."""

    def __init__(self) -> None:
        super().__init__("Anywhere")


ANYWHERE = Anywhere()
register_model(At)(models.OpaqueModel)
register_model(Anywhere)(models.OpaqueModel)


def kind_at(kind: types.Type) -> At:
    """The type of the place of a tuple of this type, whose arrays nobody counts there."""
    return At(borrowed_kind(kind))  # type: ignore[arg-type]


@infer_getattr
class _FieldsAt(AttributeTemplate):
    key = At

    def generic_resolve(self, value: Any, attr: Any) -> Any:  # type: ignore[override]
        """Return the type of a field; a tuple in the tuple stays where it is."""
        fields: Any = getattr(value.kind, "fields", ())
        kind = value.kind.types[fields.index(attr)] if attr in fields else None
        return At(kind) if isinstance(kind, types.BaseTuple) else kind


def _tuple_at(context: Any, builder: Any, kind: types.Type, place: Any) -> Any:
    return builder.bitcast(place, context.get_value_type(kind).as_pointer())


@lower_getattr_generic(At)
def _load_field(context: Any, builder: Any, at: At, value: Any, name: str) -> Any:
    kind: Any = at.kind
    number = kind.fields.index(name)
    field = cgutils.gep_inbounds(builder, _tuple_at(context, builder, kind, value), 0, number)
    if isinstance(kind.types[number], types.BaseTuple):
        return builder.bitcast(field, context.get_value_type(At(kind.types[number])))
    return builder.load(field)


@intrinsic
def whole(typingctx: Any, place: Any) -> Any:
    """The tuple that stands at a place."""

    def load(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_tuple_at(context, builder, place.kind, args[0]))

    return place.kind(place), load


@intrinsic
def zero_of(typingctx: Any, array: Any) -> Any:
    """Zero, of the type of an array's numbers."""

    def zero(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return cgutils.get_null_value(context.get_value_type(array.dtype))

    return array.dtype(array), zero


def state_of(number: types.Type) -> Borrowed:
    """The type of a flat array of numbers as the functions of a force take it."""
    return Borrowed(number, 1, "C")


# The arguments of the functions of a force (see `exunet.forces.terms.KernelCall`) between the address of the
# function and its result: a number, the place of its data, or an array of the state.
_TIME, _DATA, _STATE = "time", "data", "state"
_ARGUMENTS = {
    "place": (_TIME, _STATE, _STATE, _DATA),
    "add": (_TIME, _STATE, _STATE, _DATA, _STATE),
    "reporting": (_TIME, _STATE, _STATE, _DATA, _STATE),
    "potential": (_STATE, _DATA),
    "power": (_TIME, _STATE, _STATE, _DATA),
    "work": (_TIME, *4 * (_STATE,), _DATA),
    "verlet_work": (_TIME, _DATA),
    "remember": (_TIME, _STATE, _STATE, _DATA),
    "event": (_TIME, _STATE, _STATE, _DATA),
    "shorten": (_TIME, _TIME, _STATE, _STATE, _DATA),
}
_NOTHING = ("place", "add", "remember")  # the others a number


def signature_of(
    name: str, number: types.Type, data: types.Type
) -> tuple[types.Type, tuple[types.Type, ...]]:
    """Result and arguments of a function of a force, for states of such numbers."""
    of = {_TIME: types.float64, _DATA: data, _STATE: state_of(number)}
    result = types.none if name in _NOTHING else number
    return result, tuple(of[argument] for argument in _ARGUMENTS[name])


def _number_in(kinds: tuple[types.Type, ...], name: str) -> types.Type:
    """Return the number type of the arrays among the arguments, which are flat and contiguous."""
    states = [kind for kind, of in zip(kinds, _ARGUMENTS[name], strict=True) if of == _STATE]
    for kind in states:
        if not isinstance(kind, types.Array) or (kind.ndim, kind.layout) != (1, "C"):
            raise errors.NumbaTypeError(f"a force is asked with {kind}, which is no flat array")
    return states[0].dtype if states else types.float64  # type: ignore[attr-defined]


def _call(name: str) -> Any:
    """Return the call of a function of a force in compiled code: call(address, *arguments)."""

    def typed(typingctx: Any, *kinds: types.Type) -> Any:
        _, *given = kinds
        result, wanted = signature_of(name, _number_in(tuple(given), name), ANYWHERE)

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            convention = context.call_conv
            function = convention.get_function_type(result, wanted).as_pointer()
            passed = [
                builder.inttoptr(value, context.get_value_type(ANYWHERE)) if kind == ANYWHERE else value
                for kind, value in zip(wanted, args[1:], strict=True)
            ]
            callee = builder.inttoptr(args[0], function)
            status, value = convention.call_function(builder, callee, result, wanted, passed)
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return value

        return result(*kinds), generate

    names = ("typingctx", "address", *(f"argument_{k}" for k in range(len(_ARGUMENTS[name]))))
    parameters = [inspect.Parameter(item, inspect.Parameter.POSITIONAL_OR_KEYWORD) for item in names]
    typed.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    typed.__name__ = f"call_{name}"
    return intrinsic(typed)


(
    call_place,
    call_add,
    call_reporting,
    call_potential,
    call_power,
    call_work,
    call_verlet_work,
    call_remember,
    call_event,
    call_shorten,
) = map(_call, _ARGUMENTS)
