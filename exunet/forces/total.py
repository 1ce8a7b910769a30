"""All forces of a scene: the cable elements, the sum of the constant terms, and the kernel terms."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

from exunet.forces.cable_term import CableTerm, ElementLaw
from exunet.forces.linear_term import LinearTerm
from exunet.forces.terms import Constraint, KernelCall, KernelTerm, ScriptTerm, Switch, Term
from exunet.net.arrays import Net

Contribution = KernelTerm | LinearTerm | ElementLaw


@dataclass(frozen=True, eq=False)
class Forces:
    """The terms of a scene; linear ones are summed beforehand; None without linear ones, or constraints.

    script : what happens in a mission, a term without forces
    Iterating gives every `Term` in the order in which a kernel adds them.
    """

    cable: CableTerm
    linear: LinearTerm | None = None
    kernels: tuple[KernelTerm, ...] = ()
    constraint: Constraint | None = None
    script: ScriptTerm | None = None

    @classmethod
    def of(cls, net: Net, contributions: Iterable[Contribution] = ()) -> Forces:
        """The elements of a net under the changes of law among `contributions`, and the other terms."""
        law, linear, kernels = ElementLaw(), None, []
        for contribution in contributions:
            if isinstance(contribution, ElementLaw):
                law = law + contribution
            elif isinstance(contribution, LinearTerm):
                linear = contribution if linear is None else linear + contribution
            else:
                kernels.append(contribution)
        return cls(CableTerm(net, law), linear, tuple(kernels))

    def __iter__(self) -> Iterator[Term]:
        yield self.cable
        if self.linear is not None:
            yield self.linear
        yield from self.kernels
        if self.script is not None:
            yield self.script
        if self.constraint is not None:
            yield self.constraint

    @property
    def calls(self) -> tuple[KernelCall, ...]:
        """The calls of a kernel of all terms."""
        return tuple(call for term in self for call in term.calls)

    @property
    def on_bodies(self) -> set[str]:
        """Names of the bodies that a term acts on."""
        handed_on = () if self.constraint is None else self.constraint.bodies
        return {name for term in self.kernels for name in term.bodies}.union(handed_on)

    @cached_property
    def nonpotential(self) -> tuple[KernelTerm | LinearTerm, ...]:
        """Terms of forces without a potential, such as drag; contact and all kinds of cables have one."""
        found = tuple(term for term in self.kernels if term.potential is None and not term.only_states)
        matrix = None if self.linear is None else self.linear.on_velocity
        return found if matrix is None else (LinearTerm(damping=matrix), *found)

    @property
    def dissipates(self) -> bool:
        """True if work must be integrated along the run for the energy balance to close."""
        return any(term.dissipates for term in self)

    @property
    def has_potential(self) -> bool:
        """True if there is potential energy beside the elastic energy of the elements."""
        return any(term.has_potential for term in self)

    @property
    def switches(self) -> tuple[tuple[Term, Switch], ...]:
        """The terms that have events."""
        return tuple((term, term.switch) for term in self if term.switch is not None)

    @property
    def discrete_states(self) -> tuple[Term, ...]:
        """The terms that have a discrete state."""
        return tuple(term for term in self if term.discrete is not None)
