"""The reader of effects in reference_impl: bounds, what belongs together, what contradicts, all at once."""

from __future__ import annotations

import copy
import math
import tomllib
from pathlib import Path

import pytest

from reference_impl import Refused, read, read_document

CASES = Path(__file__).resolve().parents[2] / "cases"
FRAME = {"altitude": 700e3, "radial": [0.0, 0.0, 1.0], "along_track": [1.0, 0.0, 0.0]}
EFFECTS = {
    "orbit": {**FRAME, "model": "linear"},
    "j2": {**FRAME, "inclination": 1.7, "argument_of_latitude": 0.8},
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "rayleigh_damping": {"alpha": 0.0, "beta": 1e-8},
    "air_drag": {
        "density": 1.2,
        "drag_coefficient": 1.1,
        "bullet_drag_coefficient": 0.5,
        "bullet_area": 0.002,
    },
    "molecular_drag": {
        "altitude": 700e3,
        "flow": [-7500.0, 0.0, 0.0],
        "drag_coefficient": 2.2,
        "bullet_area": 0.002,
    },
    "solar_pressure": {
        "flux": 1361.0,
        "direction": [0.0, 1.0, 0.0],
        "pressure_coefficient": 1.3,
        "bullet_area": 0.002,
    },
    "bending": {"modulus": 1e9},
    "breaking": {"strain": 0.01},
    "thermal_strain": {"temperature_change": -50.0, "expansion_coefficient": 5e-6},
    "launch_force": {
        "kind": "gas",
        "force": 64.0,
        "stroke": 0.05,
        "spread_angle": 0.2,
        "chaser_mass": 50.0,
        "dead_length": 0.02,
        "exponent": 1.4,
    },
    "thrust": {"bullets": [0, 3], "time": [0.0, 1.0], "force": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]},
}


@pytest.fixture(scope="module")
def faults(document):
    """faults(effects, change, **case): of a square net with these effects; change: "effect.key" to value."""

    def find(names, change=None, **case):
        whole = {**document(), "effects": {name: copy.deepcopy(EFFECTS[name]) for name in names}, **case}
        if "launch_force" in names:
            del whole["launch"]
        try:
            read_document(whole, {f"effects.{key}": value for key, value in (change or {}).items()})
        except Refused as refused:
            return refused.faults
        return ()

    return find


@pytest.mark.parametrize("name", EFFECTS)
def test_each_effect_is_read(faults, name):
    assert faults([name, "orbit"] if name == "j2" else [name]) == ()


@pytest.mark.parametrize(
    ("key", "value", "fault"),
    [
        ("j2.inclination", 3.2, "effects.j2.inclination: must be at most 3.141592654, not 3.2"),
        ("j2.inclination", -0.1, "effects.j2.inclination: must be at least 0, not -0.1"),
        ("j2.argument_of_latitude", None, "effects.j2.argument_of_latitude: missing"),
        ("j2.radial", [0.0, 1.0, 0.0], "effects.j2.radial: must be that of effects.orbit"),
        (
            "j2.mean_motion",
            1e-3,
            "effects.j2: give exactly one of effects.j2.altitude and effects.j2.mean_motion",
        ),
        (
            "molecular_drag.altitude",
            149e3,
            "effects.molecular_drag.altitude: must be at least 150000, not 149000",
        ),
        (
            "molecular_drag.altitude",
            2.1e6,
            "effects.molecular_drag.altitude: must be at most 2000000, not 2100000",
        ),
        ("molecular_drag.density", 1e-9, "effects.molecular_drag: give exactly one of"),
        ("molecular_drag.altitude", None, "effects.molecular_drag: give exactly one of"),
        ("molecular_drag.flow", [1.0, 2.0], "effects.molecular_drag.flow: must be a list of 3 numbers"),
        (
            "molecular_drag.drag_coefficient",
            -1.0,
            "effects.molecular_drag.drag_coefficient: must be at least 0",
        ),
        ("molecular_drag.bullet_area", None, "effects.molecular_drag.bullet_area: missing"),
        ("air_drag.density", 0.0, "effects.air_drag.density: must be greater than 0"),
        ("air_drag.drag_coefficient", None, "effects.air_drag.drag_coefficient: missing"),
        ("air_drag.bullet_drag_coefficient", None, "effects.air_drag.bullet_drag_coefficient: missing"),
        ("air_drag.bullet_area", -1.0, "effects.air_drag.bullet_area: must be at least 0, not -1"),
        ("air_drag.wind", 1.0, "reference_impl does not know effects.air_drag.wind"),
        ("solar_pressure.flux", 0.0, "effects.solar_pressure.flux: must be greater than 0"),
        (
            "solar_pressure.direction",
            [0.0, 1.1, 0.0],
            "effects.solar_pressure.direction: must be of length 1",
        ),
        (
            "solar_pressure.pressure_coefficient",
            2.1,
            "effects.solar_pressure.pressure_coefficient: must be at most 2",
        ),
        ("bending.modulus", -1.0, "effects.bending.modulus: must be at least 0"),
        ("bending.modulus", None, "effects.bending.modulus: missing"),
        ("breaking.strain", 0.0, "effects.breaking.strain: must be greater than 0"),
        ("breaking.force", 10.0, "effects.breaking: give exactly one of effects.breaking.strain and"),
        ("breaking.strain", None, "effects.breaking: give exactly one of"),
        (
            "thermal_strain.temperature_change",
            20001.0,
            "effects.thermal_strain: |temperature_change * expansion",
        ),
        (
            "thermal_strain.expansion_coefficient",
            None,
            "effects.thermal_strain.expansion_coefficient: missing",
        ),
        ("launch_force.kind", "powder", 'reference_impl does not know effects.launch_force.kind = "powder"'),
        ("launch_force.force", 0.0, "effects.launch_force.force: must be greater than 0"),
        ("launch_force.stroke", 0.0, "effects.launch_force.stroke: must be greater than 0"),
        ("launch_force.spread_angle", 1.58, "effects.launch_force.spread_angle: must be at most 1.570796327"),
        ("launch_force.chaser_mass", 0.0, "effects.launch_force.chaser_mass: must be greater than 0"),
        ("launch_force.dead_length", 0.0, "effects.launch_force.dead_length: must be greater than 0"),
        ("launch_force.exponent", 1.0, "effects.launch_force.exponent: must be greater than 1"),
        ("launch_force.exponent", None, "effects.launch_force.exponent: missing"),
        ("thrust.bullets", [0, 0], "effects.thrust.bullets: must name each bullet once"),
        ("thrust.bullets", [4], "effects.thrust.bullets: there is no bullet 4, they go from 0 to 3"),
        ("thrust.bullets", [-1], "effects.thrust.bullets: must be from 0"),
        ("thrust.bullets", 1, "effects.thrust.bullets: must be a list of whole numbers"),
        ("thrust.time", [0.0, 0.0], "effects.thrust.time: must be at least two times that increase"),
        ("thrust.time", [-1.0, 1.0], "effects.thrust.time: must be at least 0"),
        ("thrust.force", [[1.0, 0.0, 0.0]], "effects.thrust.force: 1 vectors for 2 times"),
        ("thrust.force", [1.0, 2.0], "effects.thrust.force: must be a list of 3 numbers"),
    ],
)
def test_refuses_by_name(faults, key, value, fault):
    name = key.partition(".")[0]
    found = faults([name, "orbit"] if name == "j2" else [name], {key: value})
    assert len(found) == 1
    assert found[0].startswith(fault)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("orbit", "gravity"),
        ("orbit", "air_drag"),
        ("air_drag", "molecular_drag"),
        ("gravity", "molecular_drag"),
        ("gravity", "solar_pressure"),
        ("breaking", "bending"),
    ],
)
def test_effects_that_contradict_each_other(faults, one, other):
    assert faults([one, other]) == (
        f"effects.{one} and effects.{other} contradict each other: leave one out",
    )


def test_breaking_excludes_beta_but_not_alpha(faults):
    (fault,) = faults(["breaking", "rayleigh_damping"])
    assert fault.startswith(
        "effects.breaking and effects.rayleigh_damping.beta contradict each other: set beta to 0"
    )
    assert faults(["breaking", "rayleigh_damping"], {"rayleigh_damping": {"alpha": 1.0, "beta": 0.0}}) == ()


def test_launch_force_takes_the_place_of_launch(faults, document):
    whole = {**document(), "effects": {"launch_force": EFFECTS["launch_force"]}}
    with pytest.raises(Refused, match=r"effects\.launch_force and launch contradict each other"):
        read_document(whole)
    spring = {"launch_force.kind": "spring"}
    assert [f.split(":")[0] for f in faults(["launch_force"], spring)] == [
        "effects.launch_force.dead_length",
        "effects.launch_force.exponent",
    ]
    none = {"launch_force.dead_length": None, "launch_force.exponent": None}
    assert faults(["launch_force"], {**spring, **none}) == ()
    named = {"chaser": {"mass": 1.0, "inertia": [1.0, 1.0, 1.0]}}
    (fault,) = faults(["launch_force"], bodies=named)
    assert fault.startswith("bodies.chaser: effects.launch_force has a body of this name")
    assert faults(["orbit"], bodies=named) == ()


def test_j2_needs_its_orbit(faults):
    assert faults(["j2"]) == ("effects.j2: needs effects.orbit",)


def test_heights_must_agree(faults):
    """Of orbit, j2 and molecular_drag, each against each; a mean motion is a height too."""
    names = ["orbit", "j2", "molecular_drag"]
    assert faults(names) == ()
    mu, radius = 3.986004418e14, 6378137.0 + 700e3
    motion = {"j2.altitude": None, "j2.mean_motion": math.sqrt(mu / radius**3)}
    assert faults(names, motion) == ()
    other = {"molecular_drag.altitude": 701e3}
    assert faults(["orbit", "molecular_drag"], other) == (
        "effects.molecular_drag: its height, 701000 m, must be that of effects.orbit, 700000 m",
    )
    assert len(faults(names, other)) == 2
    assert faults(["molecular_drag"], other) == ()
    density = {"molecular_drag.altitude": None, "molecular_drag.density": 1e-9}
    assert faults(names, density) == ()
    assert len(faults(names, {"j2.altitude": 701e3})) == 2


def test_keys_of_bullets_are_given_if_and_only_if_there_are_bullets(document):
    """docs/keys.md: missing with bullets, superfluous without."""
    without = document()
    del without["net"]["bullets"], without["launch"]
    for name, keys in (
        ("air_drag", ("bullet_drag_coefficient", "bullet_area")),
        ("molecular_drag", ("bullet_area",)),
        ("solar_pressure", ("bullet_area",)),
    ):
        bare = {key: value for key, value in EFFECTS[name].items() if key not in keys}
        read_document({**without, "effects": {name: bare}})
        read_document({**document(), "effects": {name: EFFECTS[name]}})
        with pytest.raises(Refused) as refused:
            read_document({**document(), "effects": {name: bare}})
        assert refused.value.faults == tuple(f"effects.{name}.{key}: missing" for key in keys)
        with pytest.raises(Refused) as refused:
            read_document({**without, "effects": {name: EFFECTS[name]}})
        said = "leave it out, this case has no net.bullets"
        assert refused.value.faults == tuple(f"effects.{name}.{key}: {said}" for key in keys)


@pytest.mark.parametrize("name", ["launch_force", "thrust"])
def test_effects_that_need_bullets(document, explicit, name):
    without = document()
    del without["net"]["bullets"], without["launch"]
    for case in (without, explicit([[0.0, 0, 0], [1.0, 0, 0]], [[0, 1]])):
        with pytest.raises(Refused) as refused:
            read_document({**case, "effects": {name: EFFECTS[name]}})
        assert refused.value.faults == (f"effects.{name}: needs net.bullets",)


@pytest.mark.parametrize(("topology", "count"), [("hexagonal", 6), ("radial", 8), ("rectangular", 4)])
def test_numbers_of_bullets_there_are(document, topology, count):
    thrust = {**EFFECTS["thrust"], "bullets": [0, count - 1]}
    read_document({**document(topology), "effects": {"thrust": thrust}})
    with pytest.raises(Refused, match=f"there is no bullet {count}, they go from 0 to {count - 1}"):
        read_document({**document(topology), "effects": {"thrust": {**thrust, "bullets": [count]}}})


def test_faults_of_all_kinds_are_reported_at_once(document):
    """Of single keys, between effects, between tables: nothing waits for another fault to be mended."""
    case = {
        **document(),
        "time": {"end": 1000.0, "output_step": 1.0},
        "bodies": {"a b": {"mass": -1.0}},
        "effects": {
            "choose": "auto",
            "threshold": 0.1,
            "j2": {**EFFECTS["j2"], "inclination": 4.0},
            "gravity": EFFECTS["gravity"],
            "solar_pressure": {**EFFECTS["solar_pressure"], "flux": -1.0},
            "launch_force": {**EFFECTS["launch_force"], "force": "strong"},
            "thrust": {"bullets": [9], "time": [1.0], "force": []},
        },
    }
    del case["net"]["bullets"]
    case["initial"]["node_positions"] = [[0.0, 0.0, 0.0]]
    with pytest.raises(Refused) as refused:
        read_document(case)
    starts = (
        "reference_impl does not know effects.choose",
        "reference_impl does not know effects.threshold",
        "bodies.a b: the name",
        "bodies.a b.mass",
        "bodies.a b.inertia: missing",
        "effects.j2.inclination",
        "effects.j2: needs effects.orbit",
        "effects.gravity and effects.solar_pressure",
        "effects.solar_pressure.flux",
        "effects.solar_pressure.bullet_area: leave it out",
        "effects.launch_force.force",
        "effects.launch_force: needs net.bullets",
        "effects.launch_force and launch contradict",
        "effects.thrust: needs net.bullets",
        "effects.thrust.time",
        "effects.thrust.force",
        "launch: needs net.bullets",
        "initial.node_positions: only for an explicit net",
    )
    for start in starts:
        assert sum(fault.startswith(start) for fault in refused.value.faults) == 1, start
    assert len(refused.value.faults) == len(starts)


ODD = [
    "x",
    "",
    [],
    [1.0],
    [[1.0, 2.0]],
    [[1.0, 2.0, 3.0]] * 2,
    {},
    {"x": 1.0},
    float("nan"),
    float("-inf"),
    True,
    10**400,
    -(10**400),
    [float("nan")] * 3,
    ["a", "b", "c"],
    0,
    -1,
    1e308,
    5e-324,
]


@pytest.mark.parametrize("name", EFFECTS)
def test_odd_values_are_faults_not_tracebacks(faults, name):
    """Whatever stands behind a key, and in place of the table: a fault that names it, or it is read."""
    names = [name, "orbit"] if name == "j2" else [name]
    for odd in ODD:
        for key in EFFECTS[name]:
            found = faults(names, {f"{name}.{key}": odd})
            assert all(name in fault or "height" in fault for fault in found), found
        if not isinstance(odd, dict):
            assert any(
                fault.startswith(f"effects.{name}: must be a table") for fault in faults(names, {name: odd})
            )


def test_odd_bodies_are_faults_not_tracebacks(document):
    box = {
        "mass": 2.0,
        "inertia": [1.0, 2.0, 2.5],
        "position": [1.0, 2.0, 3.0],
        "velocity": [0.5, -0.25, 0.125],
        "attitude": [1.0, 2.0, -1.0, 0.5],
        "angular_velocity": [0.05, 3.0, 0.02],
    }
    for odd in ODD:
        for key in box:
            found: tuple[str, ...] = ()
            try:
                read_document({**document(), "bodies": {"box": {**box, key: odd}}})
            except Refused as refused:
                found = refused.faults
            assert all("bodies.box" in fault for fault in found)


def test_only_the_choice_by_itself_is_refused():
    """cases/effects/: every case is read but the one that asks for a choice."""
    for path in sorted((CASES / "effects").glob("*.toml")):
        if "choose" not in tomllib.loads(path.read_text()).get("effects", {}):
            assert read(path).effects is not None
            continue
        with pytest.raises(Refused) as refused:
            read(path)
        assert all("does not know effects." in fault for fault in refused.value.faults)
        assert len(refused.value.faults) == 2
