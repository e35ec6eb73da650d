"""Properties that hold for any input: the law, the weights, and what comes of a scene or results file that is none.

Beside tests/physics/test_return_map.py (closed forms), tests/mpm/test_gimp.py (one axis, one cell size) and
tests/mpm/test_config_fuzz.py (`load_scene` without the program around it).
"""

import contextlib
import dataclasses
import io
import math
import os
import random
import signal
import sys
from collections import Counter

import numpy as np
import pytest
import warp as wp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from compare.cli import main as cli
from compare.hard.law import LAWS, SAND, return_map
from explicit.run import run
from mpm.devices import KERNEL_OPTIONS, start_warp
from mpm.errors import SceneError
from mpm.gimp import NODES_PER_AXIS, gimp
from mpm.load import load_scene, preset_names, read_scene_file
from mpm.results import CHECKPOINT, RESULTS, SUMMARY, Results
from mpm.scene import Material

start_warp()
LAX = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])

# Return map

materials = st.builds(
    lambda phi, share, c, cone: Material(
        **(SAND | {"friction_angle": phi}), dilatancy_angle=share * phi, cohesion=c, cone=cone
    ).constants(),
    st.floats(0.5, 80.0),
    st.just(0.0) | st.floats(1e-6, 1.0),
    st.just(0.0) | st.floats(-3.0, 7.0).map(lambda power: 10.0**power),
    st.sampled_from(["inner", "outer", "plane_strain"]),
)
# Every order of magnitude alike, exact zero among them. Below 1e-280 products with 1/G lose digits, then all of them:
# what comes of that is a finding of its own (compare.hard.law).
sizes = st.just(0.0) | st.floats(-280.0, 100.0).map(lambda power: 10.0**power)
gaps = st.just(0.0) | st.floats(-20.0, 0.0).map(lambda power: 10.0**power)


@settings(LAX, max_examples=500)
@given(sizes, gaps, sizes, materials)
def test_a_trial_stress_of_any_size_returns_into_the_cone(below, gap, root_j2, law):
    """`below` the apex: to 1e-9 of what goes in, plastic work and strain not negative, and again the same once more."""
    sigma_m = law.xi / law.eta - below
    mean, root, dilation, d_eps, work = return_map(sigma_m, gap, root_j2, law)
    size = abs(sigma_m) + root_j2 + law.bulk * gap + law.xi
    assert np.isfinite([mean, root, dilation, d_eps, work]).all()
    assert root >= 0.0 and d_eps >= 0.0 and dilation >= 0.0 and mean <= sigma_m
    assert root + law.eta * mean - law.xi <= 1e-9 * size
    assert work >= -1e-9 * size * (d_eps if d_eps > 0.0 else 1.0)
    again = return_map(mean, max(gap - dilation, 0.0), root, law)
    assert again[:2] == pytest.approx(np.array([mean, root]), abs=1e-9 * size)
    assert again[2] <= 1e-9 * size / law.bulk


@settings(LAX, max_examples=200)
@given(sizes, gaps, sizes, materials)
def test_return_is_homogeneous_of_degree_one(pressure, gap, root_j2, law):
    """c = 0 has no stress of its own: twice the trial stress and gap return to twice the stress and dilation, to the
    bit."""
    law = dataclasses.replace(law, xi=0.0)
    once, twice = (return_map(-f * pressure, f * gap, f * root_j2, law)[:3] for f in (1.0, 2.0))
    assert np.array_equal(2.0 * once, twice)


def rotation(axis, angle):
    axis = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.cross(np.eye(3), -axis)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def full(sigma):
    return sigma[[0, 5, 4, 5, 1, 3, 4, 3, 2]].reshape(3, 3)


@settings(LAX, max_examples=40)
@given(
    st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda axis: np.linalg.norm(axis) > 0.1),
    st.floats(0.0, math.pi),
    st.integers(0, 2**31),
    st.sampled_from([1e-6, 1e-3, 3e-2]),
    st.sampled_from(LAWS),
)
def test_the_law_is_the_same_in_turned_axes(axis, angle, seed, size, law):
    """Strain paths Q g Q^T end at Q sigma Q^T: elastic, on the cone, at the apex, closing."""
    turn = rotation(axis, angle)
    path = np.random.default_rng(seed).uniform(-size, size, (4, 3, 3))
    kind = Material(**SAND, dilatancy_angle=5.0 * (seed % 2))
    one, other = law(kind, 5e3), law(kind, 5e3)
    for g in path:
        one.strain(g)
        other.strain(turn @ g @ turn.T)
    scale = SAND["young"] * size + 5e3
    assert full(other.sigma) == pytest.approx(turn @ full(one.sigma) @ turn.T, abs=1e-10 * scale)
    assert other.opening == pytest.approx(one.opening, abs=1e-12)


@settings(LAX, max_examples=20)
@given(
    st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda axis: np.linalg.norm(axis) > 0.1),
    st.floats(0.0, math.pi),
    st.integers(0, 2**31),
)
def test_a_rigid_turn_turns_the_implicit_stress_and_no_more(axis, angle, seed):
    """F = Q of any angle in one step: sigma -> Q sigma Q^T, volume and opening stay."""
    point = LAWS[1](Material(**SAND), 5e3)
    point.strain(np.random.default_rng(seed).uniform(-1e-3, 1e-3, (3, 3)))
    before, volume, opening = point.sigma, point.volume, point.opening
    turn = rotation(axis, angle)
    point.strain(turn - np.eye(3))
    assert full(point.sigma) == pytest.approx(turn @ full(before) @ turn.T, abs=1e-11 * SAND["young"])
    assert point.volume == pytest.approx(volume, abs=1e-14)
    assert point.opening == pytest.approx(opening, abs=1e-14)


# uGIMP in three dimensions

BASIS = gimp(wp.float64)
MODULE = "repose_hard_weights"
wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(MODULE))


@wp.kernel(module=MODULE)
def stencils(
    x: wp.array(dtype=wp.vec3d),
    inv_cell: wp.float64,
    base: wp.array(dtype=wp.vec3i),
    weight: wp.array2d(dtype=wp.vec3d),
    slope: wp.array2d(dtype=wp.vec3d),
):
    p = wp.tid()
    i, j, k, sx, sy, sz, dx, dy, dz = BASIS.stencil(x[p], inv_cell)
    base[p] = wp.vec3i(i, j, k)
    weight[p, 0] = sx
    weight[p, 1] = sy
    weight[p, 2] = sz
    slope[p, 0] = dx
    slope[p, 1] = dy
    slope[p, 2] = dz


def stencil(x, cell):
    """Nodes (27, 3) [m] of the point `x`, their weights (27,) and the weights' gradients (27, 3)."""
    base = wp.zeros(1, dtype=wp.vec3i, device="cpu")
    s, ds = (wp.zeros((1, 3), dtype=wp.vec3d, device="cpu") for _ in range(2))
    inputs = [wp.array([x], dtype=wp.vec3d, device="cpu"), wp.float64(1.0 / cell), base, s, ds]
    wp.launch(stencils, 1, inputs=inputs, device="cpu")
    s, ds = s.numpy()[0], ds.numpy()[0]
    place = np.argwhere(np.ones((NODES_PER_AXIS,) * 3))
    along = np.stack([s[axis, place[:, axis]] for axis in range(3)], axis=1)
    steep = np.stack([ds[axis, place[:, axis]] for axis in range(3)], axis=1)
    gradient = np.stack([steep[:, a] * along[:, a - 1] * along[:, a - 2] for a in range(3)], axis=1)
    return (base.numpy()[0] + place) * cell, along.prod(axis=1), gradient


anywhere = st.floats(-1e3, 1e3)
# Quarters of a cell: nodes, middles and where a point's domain ends on a face; and the numbers next to them.
marked = st.tuples(st.integers(-4000, 4000), st.sampled_from([-math.inf, 0.0, math.inf]))


@settings(LAX, max_examples=400)
@given(
    st.tuples(*[anywhere.map(lambda x: (x, 0.0)) | marked.map(lambda m: (0.25 * m[0], m[1]))] * 3),
    st.sampled_from([1.0, 0.125, 0.05, 1.0 / 3.0, 1e-4, 70.0]),
)
def test_weights_of_all_27_nodes_keep_their_sums(cells, cell):
    """One, gradients to zero, linear fields and their gradient exactly, none negative: but for round-off."""
    x = np.array([np.nextafter(at * cell, aside) if aside else at * cell for at, aside in cells])
    nodes, weight, gradient = stencil(x, cell)
    scale = 1.0 + np.abs(x).max() / cell  # round-off of a position counted in cells
    assert weight.sum() == pytest.approx(1.0, abs=1e-15 * 4)
    assert np.abs(gradient.sum(axis=0)).max() * cell < 1e-14
    assert weight.min() > -1e-15 * scale
    assert np.abs(weight @ nodes - x).max() < 1e-14 * scale * cell
    assert nodes.T @ gradient == pytest.approx(np.eye(3), abs=1e-13 * scale)


# Scene files, through the program

TEXTS = [(read_scene_file(name)[1] / f"{name}.toml").read_text(encoding="utf-8") for name in preset_names()]
PIECES = [
    "",
    "=",
    "[",
    "]",
    "{",
    "\n",
    '"',
    ".",
    "#",
    "[grid]\n",
    "inf",
    "-nan",
    "1e999",
    "9" * 400,
    "0x",
    "[[[",
    "'''",
]
PIECES += ["\ufeff", "\u2028", "true", "1979-05-27", "\\u0000", "\x00", "rest", "shape = 'mesh'\n", "file = '/'\n", "-"]


def call(*arguments):
    """`repose ARGUMENTS` in this process: exit code, stdout, stderr. What is not a SystemExit is a traceback."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        patch.setattr(sys, "argv", ["repose", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
    return end.value.code or 0, out.getvalue(), err.getvalue()


def assert_refused(answer):
    code, out, err = answer
    assert code == SceneError.exit_code and out == ""
    assert err.startswith("error: ") and "Traceback" not in err
    assert err.strip()


def mangled(chance: random.Random) -> bytes:
    """A scene's text with pieces cut out, doubled or replaced, or bytes of no meaning."""
    if chance.random() < 0.1:
        return chance.randbytes(chance.randrange(80))
    text = chance.choice(TEXTS)
    for _ in range(chance.randrange(1, 5)):
        start = chance.randrange(len(text) + 1)
        end = min(len(text), start + chance.randrange(14))
        text = text[:start] + chance.choice([*PIECES, text[start:end] * 2]) + text[end:]
    content = text.encode("utf-8", "surrogatepass")
    if chance.random() < 0.2:
        at = chance.randrange(len(content) + 1)
        content = content[:at] + chance.randbytes(3) + content[at:]
    return content


@settings(LAX, max_examples=60)
@given(st.binary(max_size=80) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "surrogatepass")))
def test_the_program_refuses_any_bytes_in_words(tmp_path, data):
    path = tmp_path / "scene.toml"
    path.write_bytes(data)
    assert_refused(call("validate", path))
    assert_refused(call("run", path, "--out", tmp_path / "run"))
    assert not (tmp_path / "run").exists()


@settings(LAX, max_examples=40)
@given(st.integers(0, 2**32))
def test_the_program_refuses_a_mangled_scene_in_words(tmp_path, seed):
    path = tmp_path / "scene.toml"
    path.write_bytes(mangled(random.Random(seed)))
    with contextlib.suppress(SceneError):
        load_scene(str(path))
        return  # a scene all the same
    assert_refused(call("validate", path))


@pytest.mark.slow
def test_ten_thousand_mangled_scenes(tmp_path):
    """Each a scene or a SceneError; one in fifty through the program."""
    path, chance, refused = tmp_path / "scene.toml", random.Random(20240229), 0
    for count in range(10_000):
        path.write_bytes(mangled(chance))
        try:
            load_scene(str(path))
        except SceneError as error:
            refused += 1
            assert error.problems and all(line.strip() for line in error.problems)
            if count % 50 == 0:
                assert_refused(call("validate", path))
    assert refused > 5_000


# Results that were cut off or damaged


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A run that can be resumed: folder and bytes of its two files."""
    folder = tmp_path_factory.mktemp("stopped") / "run"
    overrides = ["grid.cell=0.25", "explicit.until=0.04", "output.every=0.01", "output.vtk=false"]
    run(load_scene("column_small", overrides), folder)
    (folder / SUMMARY).unlink()
    return folder, {name: (folder / name).read_bytes() for name in (RESULTS, CHECKPOINT)}


def put(folder, files):
    for name, content in files.items():
        (folder / name).write_bytes(content)


def read_all(folder):
    """Everything that the results store can read."""
    results = Results.open(folder)
    results.scene, results.provenance, results.times, results.field_names  # noqa: B018
    results.history(), results.read_static("x0")
    for index in range(results.snapshot_count):
        results.snapshot(index)
    results.read_checkpoint()


@pytest.mark.slow
@pytest.mark.parametrize("name", [RESULTS, CHECKPOINT])
def test_files_cut_short_are_refused_in_words(stopped, name):
    """At forty lengths, the empty file and one byte too few among them: open, resume, plot."""
    folder, whole = stopped
    size = len(whole[name])
    for length in sorted({0, 1, 8, 96, 800, size - 1, *random.Random(1).sample(range(size), 34)}):
        put(folder, whole | {name: whole[name][:length]})
        with pytest.raises(SceneError, match=f"{name} cannot be read"):
            read_all(folder)
        assert_refused(call("resume", folder))
        if name == RESULTS:
            assert_refused(call("plot", folder))
    put(folder, whole)
    read_all(folder)


def damaged(content: bytes, chance: random.Random) -> bytes:
    """A few bits turned, or a stretch of bytes zero or noise."""
    content, at = bytearray(content), chance.randrange(len(content))
    if chance.random() < 0.5:
        for _ in range(chance.choice([1, 3, 30])):
            content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    else:
        at = chance.randrange(4000) if chance.random() < 0.5 else at  # HDF5 describes itself at the start
        length = min(chance.choice([1, 8, 64, 1024, 8192]), len(content) - at)
        content[at : at + length] = chance.randbytes(length) if chance.random() < 0.5 else bytes(length)
    return bytes(content)


def answer_apart(read, seconds=4) -> str:
    """How `read()` ends in a forked process: HDF5 may loop for ever on what it reads, or crash."""
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGSEGV, signal.SIG_DFL)
        signal.alarm(seconds)
        try:
            read()
            text = "read"
        except SceneError:
            text = "SceneError"
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"[:200]
        os.write(sender, text.encode("utf-8", "replace"))
        os._exit(0)
    os.close(sender)
    with os.fdopen(receiver, "rb") as pipe:
        text = pipe.read().decode()
    _, status = os.waitpid(child, 0)
    return signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else text


@pytest.mark.slow
def test_damaged_files_are_read_or_refused_in_words(stopped):
    """HDF5 itself may loop on what it reads: one file of these 300, when this was written."""
    folder, whole = stopped
    chance, ends = random.Random(2), Counter()
    for _ in range(300):
        name = chance.choice([RESULTS, CHECKPOINT])
        put(folder, whole | {name: damaged(whole[name], chance)})
        end = answer_apart(lambda: read_all(folder))
        ends[end.split(":")[0]] += 1
    put(folder, whole)
    assert set(ends) <= {"read", "SceneError", "SIGALRM"}, ends
    assert ends["SIGALRM"] <= 3, ends
