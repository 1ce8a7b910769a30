"""What of the rule of a capture can never hold in a scene."""

from __future__ import annotations

from collections.abc import Iterator

from exunet.case.scene import Scene
from exunet.forces.contact.spheres import SphereContact
from exunet.forces.contact.threads import ThreadContact
from exunet.system.system import System


def unreachable(scene: Scene, system: System) -> Iterator[str]:
    """In words, for notes; a script that ends the run, or a shorter `time.end`, may have it so on purpose."""
    rule = scene.verdict
    if rule is None:
        return
    if rule.duration > scene.time.end * (1.0 + 1e-12):
        words = f"verdict.duration of {rule.duration:g} s is longer than the run of {scene.time.end:g} s"
        yield f"{words}: {rule.target} cannot be captured in it"
    most = sum(_touching(term.data) for term in system.forces.kernels if _is_of(term.memory, rule.target))
    if rule.touching is not None and rule.touching > most:
        words = f"verdict.touching asks for {rule.touching} where {most} can touch {rule.target}"
        yield f"{words}: it cannot be captured"


def _is_of(memory: object, target: str) -> bool:
    """True of the memory of threads, or nodes, that touch the target; bullets do not count."""
    return getattr(memory, "name", "") in (f"contact/threads/{target}", f"contact/nodes/{target}")


def _touching(data: object) -> int:
    """How many there are."""
    if isinstance(data, ThreadContact):
        return int(data.length.size)
    return int(data.node.size) if isinstance(data, SphereContact) else 0
