"""The pictures: not blank, and drawn from the right numbers."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.image import imread

from compare.metrics import highest, profile
from compare.plots.hard import draw_case, over_limit
from compare.plots.run import plot_history, plot_morphology, plot_profile
from implicit.pseudo_time import REST_UNBALANCED
from mpm.body import build
from mpm.errors import SceneError
from mpm.load import parse_scene
from mpm.results import Results
from mpm.theory import eq4, quasistatic_profile

CELL = 0.125
TAN = np.tan(np.radians(37.55))


SHAPES = {
    "column": {"radius": 1.0, "aspect_ratio": 1.0},
    "box": {"size": [1.0, 1.0, 1.0]},
    "mesh": {"file": "heap.stl"},
}


def scene(shape="column", model="drucker_prager", symmetry="quarter", cell=CELL):
    geometry = {"shape": shape} | SHAPES[shape] | ({"symmetry": symmetry} if shape == "column" else {})
    material = {"model": model, "young": 1e6, "poisson": 0.3, "density": 2000.0, "friction_angle": 37.55}
    return parse_scene({"name": "synthetic", "geometry": geometry, "grid": {"cell": cell}, "material": material})


def block(count, spacing):
    """Lattice points of a box of `count` points along x, y, z."""
    return (np.indices(count).reshape(3, -1).T + 0.5) * spacing


def eq4_deposit(x0):
    """Points of a column of radius and height 1 moved, ring by ring, into Eq. 4's solid."""
    r = np.linspace(0.0, 1.0 + eq4(1.0, TAN), 4000)
    height = quasistatic_profile(1.0, TAN, r)
    volume_inside = np.cumsum(r * height)
    r0 = np.hypot(x0[:, 0], x0[:, 1])
    radius = np.interp(r0**2, volume_inside / volume_inside[-1], r)
    x = x0 * (radius / r0)[:, None]
    x[:, 2] = x0[:, 2] * np.interp(radius, r, height)
    return x


def store(directory, scene, x0, x, history=(), axis=(0.0, 0.0), **fields):
    run = Results.create(directory, scene, {})
    run.write_static("x0", x0)
    run.write_static("extent", np.array([1.0, 1.0, *axis]))
    run.write_snapshot(2.0, 100, {"x": x, "displacement": x - x0, **fields})
    run.append_history(list(history))
    return run


@pytest.fixture
def column(tmp_path):
    """A quarter column that has become exactly Eq. 4's solid, with a plausible history."""
    x0 = block((16, 16, 16), CELL / 2)
    x0 = x0[np.hypot(x0[:, 0], x0[:, 1]) <= 1.0]
    x = eq4_deposit(x0)
    rows = [
        {"time": t, "R_max": 0.6 * t, "R_995": 0.5 * t, "R_connected": 0.55 * t}
        | {"W_ext": 100 * t, "KE_points": 20 * t, "KE_grid": 19 * t, "E_elastic": 7.0}
        | {"W_plastic": 60 * t, "W_damping": 12 * t, "W_decay": 3 * t, "residual": 5 * t}
        for t in np.linspace(0, 1, 20)
    ]
    volume = np.full(len(x), (CELL / 2) ** 3)
    return store(tmp_path / "run", scene(), x0, x, rows, volume=volume, eps_p_eqv=np.hypot(*(x - x0)[:, ::2].T))


def colours(figure):
    """Distinct colours of a picture, and the part of it that is not background."""
    file = io.BytesIO()
    figure.savefig(file)
    file.seek(0)
    pixels = np.round(imread(file)[..., :3] * 255).astype(int).reshape(-1, 3)
    codes, counts = np.unique(pixels @ [65536, 256, 1], return_counts=True)
    return len(codes), 1.0 - counts.max() / counts.sum()


def line(axes, label):
    (found,) = (item for item in axes.lines if item.get_label() == label)
    return found.get_xydata()


@pytest.mark.parametrize(
    ("plot", "least_colours", "least_ink"),
    [(plot_morphology, 1000, 0.1), (plot_profile, 100, 0.1), (plot_history, 100, 0.02)],
)
def test_picture_is_not_blank(column, plot, least_colours, least_ink):
    count, ink = colours(plot(column))
    assert count > least_colours
    assert ink > least_ink


def test_colour_scale_ends_at_the_98_percent_quantile(column):
    figure = plot_morphology(column)
    _, section, scale = figure.axes
    strain = column.snapshot(-1)["eps_p_eqv"]
    assert scale.get_ylabel() == "equivalent plastic strain [-]"
    assert section.collections[0].get_clim() == (0.0, pytest.approx(np.quantile(strain, 0.98)))


def test_section_shows_the_points_by_the_symmetry_plane_and_the_initial_outline(column):
    figure = plot_morphology(column)
    section = figure.axes[1]
    x = column.snapshot(-1)["x"]
    near = x[np.abs(x[:, 1]) < CELL]
    np.testing.assert_array_equal(section.collections[0].get_offsets(), near[:, [0, 2]])
    outline = section.lines[0].get_xydata()
    np.testing.assert_allclose(outline.min(axis=0), [0, 0], atol=1e-12)
    np.testing.assert_allclose(outline.max(axis=0), [1.0, 1.0], atol=1e-12)
    assert section.get_aspect() == 1.0


def test_elastic_scene_is_coloured_by_displacement_and_has_no_eq4(tmp_path):
    x0 = block((8, 8, 8), CELL / 2)
    rows = [{"time": t, "R_max": 0.0, "W_ext": t, "KE_points": 0.0, "E_elastic": t} for t in (0.0, 1.0)]
    run = store(tmp_path / "run", scene(model="elastic"), x0, x0 * [1, 1, 0.9], rows)
    figures = [plot(run) for plot in (plot_morphology, plot_profile, plot_history)]
    for figure in figures:
        assert colours(figure)[0] > 50
    assert figures[0].axes[2].get_ylabel() == "displacement [m]"
    labels = [text.get_text() for figure in figures[1:] for text in figure.axes[0].get_legend().get_texts()]
    assert labels and not any("Eq. 4" in label for label in labels)


def test_undeformed_and_one_point_thick_bodies_can_be_drawn(tmp_path):
    """No strain gives no colour range, one layer of points has no hull of its own."""
    x0 = block((8, 1, 8), CELL / 2)
    run = store(tmp_path / "run", scene("box"), x0, x0, eps_p_eqv=np.zeros(len(x0)))
    assert colours(plot_morphology(run))[0] > 50


def test_flat_body_off_its_axis_is_cut_where_it_comes_nearest_to_it(tmp_path):
    x0 = block((8, 8, 8), CELL / 2) + np.array([0.0, 5.0, 0.0])
    run = store(tmp_path / "run", scene("mesh"), x0, x0)
    figure = plot_morphology(run)
    assert "y = 5.03 m" in figure.axes[1].get_title(loc="left")
    assert len(figure.axes[1].collections[0].get_offsets()) == 2 * 8 * 8


@pytest.mark.parametrize(
    ("top", "axis", "plane"),
    [
        ((0.5, 2.0), (0.5, 1.0), "y = 2.03 m"),  # a peak off the axis
        ((0.5, 1.0), (0.5, 1.05), "y = 1.05 m"),  # one within a cell of it
        (None, (0.5, 1.1), "y = 1.1 m"),  # a flat top: the axis
    ],
)
def test_section_of_a_mesh_body_passes_through_its_top(tmp_path, top, axis, plane):
    x0 = block((8, 24, 4), CELL / 2)
    if top:
        tower = block((2, 2, 8), CELL / 2) + np.array([*top, 0.0])
        x0 = np.unique(np.concatenate([x0, tower]).round(9), axis=0)
    run = store(tmp_path / "run", scene("mesh"), x0, x0, axis=axis)
    figure = plot_morphology(run)
    assert plane in figure.axes[1].get_title(loc="left")


def test_200_000_points_are_drawn_as_the_surface_of_their_cells(tmp_path):
    x0 = block((60, 60, 56), 0.025)
    run = store(tmp_path / "run", scene("box", cell=0.05), x0, x0 * [1.3, 1.3, 0.6], eps_p_eqv=x0[:, 2])
    view = plot_morphology(run).axes[0]
    assert 39**2 < len(view.collections[-1].get_facecolor()) < 5000


def test_profile_of_eq4s_solid_lies_on_eq4(column):
    figure = plot_profile(column)
    axes = figure.axes[0]
    r, height = line(axes, "Eq. 4 (quasistatic)").T
    rings, top = line(axes, "top of the deposit, rings one cell wide").T
    rings, top = rings[np.isfinite(top)], top[np.isfinite(top)]
    np.testing.assert_allclose(top, np.interp(rings, r, height), atol=CELL)
    np.testing.assert_array_equal(line(axes, "initial column"), [[0, 1], [1, 1], [1, 0]])


@pytest.mark.parametrize(("symmetry", "low"), [("full", (-8, -8)), ("half", (-8, 0)), ("quarter", (0, 0))])
def test_thickness_is_the_height_of_a_flat_topped_column_for_every_symmetry(symmetry, low):
    spacing = 0.0625
    corner = np.array([*low, 0])
    x = (np.indices((*(8 - corner[:2]), 4)).reshape(3, -1).T + 0.5 + corner) * spacing
    x = x[np.hypot(x[:, 0], x[:, 1]) <= 0.5]
    rings = profile(x, scene(symmetry=symmetry))
    full = len(rings.thickness) - 1
    np.testing.assert_allclose(highest(x, scene(symmetry=symmetry))[:full], 0.25)
    assert rings.volume == pytest.approx(len(x) * spacing**3)
    np.testing.assert_allclose(rings.thickness[:full], 0.25, rtol=0.35)  # a lattice fills thin rings unevenly


def test_profile_is_refused_for_a_box(tmp_path):
    x0 = block((4, 4, 4), CELL / 2)
    run = store(tmp_path / "run", scene("box"), x0, x0)
    with pytest.raises(SceneError, match="only a column"):
        plot_profile(run)


def test_history_shows_run_outs_eq4_and_every_energy(column):
    figure = plot_history(column)
    run_out, spent, held = figure.axes
    times, r_max = line(run_out, "farthest point").T
    np.testing.assert_allclose(r_max, 0.6 * times)
    assert line(run_out, "Eq. 4 (quasistatic)")[0, 1] == pytest.approx(float(eq4(1.0, TAN)))
    history = column.history()
    shown = {item.get_label(): item.get_ydata() for item in (*spent.lines, *held.lines)}
    np.testing.assert_array_equal(shown["plastic dissipation"], history["W_plastic"])
    np.testing.assert_array_equal(shown["residual"], history["residual"])
    np.testing.assert_array_equal(shown["decay of unseen velocities"], history["W_decay"])
    assert len(shown) == 8
    assert (run_out.get_xlabel(), held.get_xlabel(), spent.get_ylabel()) == ("time [s]", "time [s]", "energy [J]")


def test_history_of_an_implicit_run_shows_balance_and_iterations(tmp_path):
    x0 = block((8, 8, 8), CELL / 2)
    rows = [
        {"time": t, "R_max": 0.6 * t, "R_995": 0.5 * t, "unbalanced": 0.1**t if t else np.inf, "newton": 2 * t}
        for t in range(4)
    ]
    run = store(tmp_path / "run", scene(), x0, x0, rows)
    figure = plot_history(run)
    assert colours(figure)[0] > 50
    run_out, balance, counts = figure.axes
    np.testing.assert_allclose(line(run_out, "farthest point")[:, 1], [0.0, 0.6, 1.2, 1.8])
    np.testing.assert_allclose(line(balance, "out-of-balance")[1:, 1], [0.1, 0.01, 0.001])
    assert line(balance, "bound for rest")[0, 1] == REST_UNBALANCED
    np.testing.assert_array_equal(line(counts, "Newton iterations"), [[1, 2], [2, 4], [3, 6]])
    assert balance.get_yscale() == "log"
    assert (run_out.get_xlabel(), balance.get_xlabel()) == ("pseudo-time [s]", "pseudo-time [s]")


@pytest.mark.parametrize("plot", [plot_morphology, plot_profile, plot_history])
def test_empty_run_is_a_scene_error(tmp_path, plot):
    run = Results.create(tmp_path / "run", scene(), {})
    with pytest.raises(SceneError, match="to plot"):
        plot(run)


def test_nothing_global_is_left_behind(column):
    import matplotlib
    from matplotlib import _pylab_helpers

    before = dict(matplotlib.rcParams)
    for plot in (plot_morphology, plot_profile, plot_history):
        plot(column)
    assert dict(matplotlib.rcParams) == before
    assert _pylab_helpers.Gcf.get_all_fig_managers() == []


@pytest.mark.parametrize(
    ("value", "limit", "share"), [(0.5, 2.0, 0.25), (0, 0, 1e-3), (3, 0, 1e2), (None, None, 1e2), (1e-9, 1.0, 1e-3)]
)
def test_figures_of_a_hard_case_are_shown_over_their_limits(value, limit, share):
    assert over_limit({"value": value, "limit": limit}) == pytest.approx(share)


def test_picture_of_a_hard_case_shows_limits_and_ends(tmp_path):
    body = build(scene())
    runs = {"it falls": SimpleNamespace(body=body, x=body.x * [1.5, 1.5, 0.5])}
    rows = [{"what": "it falls", "solver": "explicit", "value": 0.1, "limit": 0.2, "outcome": "stable"}]
    rows.append({"what": "the rest", "solver": "", "value": None, "limit": None, "outcome": "refused"})
    with_end, without = (draw_case(rows, which, tmp_path / f"{len(which)}.png") for which in (runs, {}))
    tall, low = imread(with_end), imread(without)
    assert tall.shape[0] > 1.5 * low.shape[0] and tall.shape[1] == low.shape[1]
    assert len(np.unique(tall.reshape(-1, tall.shape[2]), axis=0)) > 200
