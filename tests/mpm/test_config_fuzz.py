"""Whatever is in a scene file or an override, the answer is a scene or a SceneError: never another exception."""

import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mpm.errors import SceneError
from mpm.load import load_scene, parse_scene, preset_names, read_scene_file
from mpm.walls import walls_of
from mpm.wording import RETIRED

FUZZ = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])

PRESETS = preset_names()
TEXTS = [(read_scene_file(name)[1] / f"{name}.toml").read_text(encoding="utf-8") for name in PRESETS]
KEYS = sorted(
    {
        f"{section}.{key}"
        for name in PRESETS
        for section, keys in load_scene(name).model_dump().items()
        if isinstance(keys, dict)
        for key in keys
    }
    | {"name", "geometry", "grid", "material", "loads", "geometry.walls.x_min", "geometry.file", "nonsense"}
    | set(RETIRED)
)

# Values that have broken parsers before, among random ones.
AWKWARD = ["", "0", "-1", "inf", "-nan", "1e999", "5e-324", "9" * 5000, "0x" + "f" * 300, "[" * 3000, "{}", "[[]]"]
AWKWARD += ["1979-05-27", "00:00:00", "'rest'", "true", '"\\u0000"', "'''\n'''", "1 # x", "{a.b = 1}", '"\u2028"']
values = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(
        [5e-324, 1e308, -0.0, 10**400, "rest", "elastic", "box", "mesh", "full", "paper", "fixed", 2, 0.25]
    ),
)
tree = st.recursive(
    values,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)


def answer(parse, *arguments):
    """The scene, or None for a SceneError, whose every problem must be one line of text."""
    try:
        scene = parse(*arguments)
    except SceneError as refusal:
        assert refusal.problems
        assert all(isinstance(line, str) and line.strip() for line in refusal.problems)
        return None
    # What a run derives from the scene first must work too.
    assert all(low <= high for low, high in zip(walls_of(scene).low, walls_of(scene).high, strict=True))
    constants = scene.material.constants()
    assert not any(map(math.isnan, (constants.eta, constants.xi, constants.opens_at)))
    return scene


@st.composite
def mutated_texts(draw):
    """A preset's text with a few pieces cut out, doubled or replaced."""
    text = draw(st.sampled_from(TEXTS))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.integers(0, 12)))
        piece = draw(st.sampled_from(["", text[start:end] * 2, "=", "[", "]", "\n", '"', ".", "[grid]\n", *AWKWARD]))
        text = text[:start] + piece + text[end:]
    return text


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz") / "scene.toml"


@pytest.mark.parametrize("tiny", ["material.young=5e-324", "material.friction_angle=5e-324"])
def test_moduli_and_slopes_that_underflow(tiny):
    assert answer(load_scene, "column_small", ["material.poisson=0", "material.cohesion=1", tiny]) is not None


@FUZZ
@given(text=mutated_texts())
def test_mutated_files(scene_file, text):
    scene_file.write_text(text, encoding="utf-8", errors="surrogatepass")
    answer(load_scene, str(scene_file))


@FUZZ
@given(data=st.binary(max_size=60))
def test_any_bytes(scene_file, data):
    scene_file.write_bytes(data)
    assert answer(load_scene, str(scene_file)) is None


@FUZZ
@given(
    preset=st.sampled_from(PRESETS),
    items=st.lists(st.tuples(st.sampled_from(KEYS), st.sampled_from(AWKWARD) | st.text(max_size=12)), max_size=4),
)
def test_any_overrides(preset, items):
    answer(load_scene, preset, [f"{key}={value}" for key, value in items])


@FUZZ
@given(preset=st.sampled_from(PRESETS), changes=st.lists(st.tuples(st.sampled_from(KEYS), tree), max_size=4))
def test_any_values_for_any_keys(preset, changes):
    table, _ = read_scene_file(preset)
    for key, value in changes:
        *path, last = key.split(".")
        section = table
        for name in path:
            section = section[name] if isinstance(section.get(name), dict) else section.setdefault(name + "_", {})
        section[last] = value
    answer(parse_scene, table)


@FUZZ
@given(table=st.dictionaries(st.sampled_from(["name", "geometry", "grid", "material"]) | st.text(max_size=5), tree))
def test_any_table(table):
    answer(parse_scene, table)


@FUZZ
@given(reference=st.text(max_size=20))
def test_any_reference(reference):
    if reference not in PRESETS:
        assert answer(load_scene, reference) is None
