"""Drucker-Prager: cone constants against tabulated values, the return map against closed forms."""

import math

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from mpm.devices import start_warp
from mpm.drucker_prager import Constants, cone_slope, cone_strength, drucker_prager

start_warp()
LAW = drucker_prager(wp.float64)
VEC5, VEC4 = wp.types.vector(5, wp.float64), wp.types.vector(4, wp.float64)
BULK, SHEAR, PHI = 4.8667e6, 2.2462e6, 37.55


@wp.kernel(module="repose_float64")
def returned(
    mean: wp.array(dtype=wp.float64),
    root: wp.array(dtype=wp.float64),
    opening: wp.array(dtype=wp.float64),
    material: LAW.Material,
    out: wp.array(dtype=VEC5),
):
    p = wp.tid()
    m, scale, opened, d_eps, work = LAW.return_map(mean[p], root[p], opening[p], material)
    out[p] = VEC5(m, scale, d_eps, work, opened)


@wp.kernel(module="repose_float64")
def sloped(
    mean: wp.array(dtype=wp.float64),
    root: wp.array(dtype=wp.float64),
    opening: wp.array(dtype=wp.float64),
    material: LAW.Material,
    out: wp.array(dtype=VEC4),
):
    p = wp.tid()
    mean_m, mean_r, root_m, root_r = LAW.return_slopes(mean[p], root[p], opening[p], material)
    out[p] = VEC4(mean_m, mean_r, root_m, root_r)


def material(phi=PHI, psi=0.0, cohesion=0.0, cone="inner", bulk=BULK, shear=SHEAR):
    slopes = cone_slope(phi, cone), cone_slope(psi, cone)
    return Constants(bulk, shear, *slopes, cone_strength(cohesion, phi, cone), 2000.0, True, True)


def return_map(mean, root, constants, opening=0.0):
    """(sigma_m, sqrt(J2), d_eps, work, opening) after the return."""
    mean, root, opening = np.broadcast_arrays(*(np.atleast_1d(np.asarray(a, float)) for a in (mean, root, opening)))
    out = wp.zeros(len(mean), dtype=VEC5, device="cpu")
    inputs = [wp.array(a, dtype=wp.float64, device="cpu") for a in (mean, root, opening)]
    wp.launch(returned, len(mean), inputs=[*inputs, LAW.pack(constants), out], device="cpu")
    m, scale, d_eps, work, opened = out.numpy().T
    return m, scale * root, d_eps, work, opened


def return_slopes(mean, root, constants, opening):
    """d mean/d sigma_m, d mean/d sqrt(J2), and the same of the returned sqrt(J2), as rows."""
    out = wp.zeros(len(mean), dtype=VEC4, device="cpu")
    inputs = [wp.array(a, dtype=wp.float64, device="cpu") for a in (mean, root, opening)]
    wp.launch(sloped, len(mean), inputs=[*inputs, LAW.pack(constants), out], device="cpu")
    return out.numpy().T


@pytest.mark.parametrize(("cone", "eta"), [("inner", 0.5849), ("outer", 0.8831), ("plane_strain", 0.5749)])
def test_cone_slopes_for_the_papers_sand(cone, eta):
    assert cone_slope(PHI, cone) == pytest.approx(eta, abs=1e-4)


def test_cohesive_strength_of_each_cone():
    """xi/eta = c cot(phi) for every cone: all share the Mohr-Coulomb apex."""
    for cone in ("inner", "outer", "plane_strain"):
        apex = cone_strength(1e4, 30.0, cone) / cone_slope(30.0, cone)
        assert apex == pytest.approx(1e4 / math.tan(math.radians(30.0)), rel=1e-12)


@pytest.mark.parametrize(("cone", "ratio"), [("inner", 2.5297), ("outer", 4.1210)])
def test_triaxial_compression_ends_at_the_closed_form(cone, ratio):
    """Axial strain in small steps at constant cell pressure ends at sigma_1/sigma_3 = (sqrt3+2eta)/(sqrt3-eta)."""
    constants = material(cone=cone)
    cell_pressure = -100e3
    # Stress state (axial, lateral); each step prescribes the axial strain and finds the lateral one.
    axial = lateral = cell_pressure
    step = -1e-3
    for _ in range(200):

        def lateral_stress(lateral_strain, axial=axial, lateral=lateral):
            dilation = step + 2 * lateral_strain
            mean = (axial + 2 * lateral) / 3 + BULK * dilation
            deviator = 2 * (axial - lateral) / 3 + 2 * SHEAR * (step - dilation / 3)  # axial deviatoric stress
            root = abs(deviator) * math.sqrt(0.75)
            m, r, *_ = return_map(mean, root, constants)
            s = math.copysign(r[0] / math.sqrt(0.75), deviator)
            return m[0] + s, m[0] - s / 2

        low, high = -2 * abs(step), 2 * abs(step)  # lateral stress grows with lateral strain
        for _ in range(45):
            middle = 0.5 * (low + high)
            if lateral_stress(middle)[1] > cell_pressure:
                high = middle
            else:
                low = middle
        axial, lateral = lateral_stress(middle)
        if abs(axial / lateral - ratio) < 1e-6:
            break
    eta = cone_slope(PHI, cone)
    exact = (math.sqrt(3) + 2 * eta) / (math.sqrt(3) - eta)
    assert exact == pytest.approx(ratio, abs=1e-4)
    assert axial / lateral == pytest.approx(exact, rel=1e-6)
    assert lateral == pytest.approx(cell_pressure, rel=1e-6)


def test_isotropic_extension_ends_at_the_apex():
    """At c = 0 any tension returns to zero stress exactly, with no deviator to divide by."""
    constants = material()
    mean, root, d_eps, work, opened = return_map([1e3, 1.0, 1e-12], [0.0, 0.0, 0.0], constants)
    assert np.all(mean == 0.0) and np.all(root == 0.0)
    # eps_v = sigma_m/K is all plastic: sqrt(2/3 eps:eps) = sqrt(2)/3 eps_v
    assert d_eps == pytest.approx(math.sqrt(2) / 3 * np.array([1e3, 1.0, 1e-12]) / BULK, rel=1e-9)
    assert np.all(work == 0.0)
    assert opened == pytest.approx(np.array([1e3, 1.0, 1e-12]) / BULK, rel=1e-14)


def test_tension_with_shear_returns_to_zero_and_to_the_cohesive_apex():
    mean, root, *_ = return_map([5e3, 1e2, -5.0], [2e3, 1e1, 1e1], material())
    assert np.all(mean[:2] == 0.0) and np.all(root[:2] == 0.0)
    assert mean[2] == -5.0 and root[2] == pytest.approx(5.0 * cone_slope(PHI, "inner"))
    cohesive = material(cohesion=1e3)
    mean, root, *_ = return_map([1e5], [1.0], cohesive)
    assert mean[0] == pytest.approx(1e3 / math.tan(math.radians(PHI)), rel=1e-12)
    assert root[0] == 0.0


def test_shear_return_closed_form():
    """psi = 0: pressure unchanged, sqrt(J2) = eta p, d_eps = (sqrt(J2)_trial - eta p)/(sqrt3 G)."""
    constants = material()
    mean, root, d_eps, work, opened = return_map([-1e4], [2e4], constants)
    assert mean[0] == -1e4 and opened[0] == 0.0
    assert root[0] == pytest.approx(constants.eta * 1e4, rel=1e-14)
    assert d_eps[0] == pytest.approx((2e4 - root[0]) / (math.sqrt(3) * SHEAR), rel=1e-12)
    assert work[0] == pytest.approx(root[0] * (2e4 - root[0]) / SHEAR, rel=1e-12)  # sqrt(J2) times gamma_p


@settings(max_examples=300, deadline=None)
@given(
    st.floats(-1e7, 1e7), st.floats(0.0, 1e7), st.floats(1.0, 60.0), st.floats(0.0, 1.0), st.floats(0.0, 1e5),
    st.sampled_from(["inner", "outer", "plane_strain"]),
)  # fmt: skip
def test_any_trial_state_ends_inside_the_cone(mean, root, phi, psi_share, cohesion, cone):
    """Inside to 1e-9 of the stress, plastic work not negative, and a second return changes nothing."""
    constants = material(phi, psi_share * phi, cohesion, cone)
    m, r, d_eps, work, opened = (a[0] for a in return_map(mean, root, constants))
    size = 1.0 + abs(mean) + root
    assert r + constants.eta * m - constants.xi <= 1e-9 * size
    assert r >= 0 and d_eps >= 0 and opened >= 0 and work >= -1e-9 * size**2 / BULK
    again_m, again_r, _, _, again_opened = (a[0] for a in return_map(m, r, constants, opened))
    assert again_m == pytest.approx(m, abs=1e-9 * size)
    assert again_r == pytest.approx(r, abs=1e-9 * size)
    assert again_opened == pytest.approx(opened, abs=1e-9 * size / BULK)


def test_what_opened_at_the_apex_closes_before_pressure_returns():
    """A closed loop of volume strain, +e then -e, ends at the stress it began with: no volume is gained."""
    constants = material()
    p0, steps, e = 5e3, 50, 0.02
    mean, opening = -p0, 0.0
    path = [e / steps] * steps + [-e / steps] * steps
    total = 0.0
    for increment in path:
        total += increment
        mean, root, _, _, opening = (a[0] for a in return_map(mean + BULK * increment, 0.0, constants, opening))
        assert root == 0.0
        assert mean == pytest.approx(min(-p0 + BULK * total, 0.0), abs=1e-6)  # zero while open, elastic once closed
        assert opening == pytest.approx(max(total - p0 / BULK, 0.0), abs=1e-15)
    assert mean == pytest.approx(-p0, rel=1e-9)


def test_a_cohesive_gap_closes_without_tension():
    """c > 0: unloading from the apex is elastic, the gap closes at zero stress, and no work is handed back."""
    constants = material(cohesion=1e3)
    apex = constants.xi / constants.eta
    mean, opening, stresses, works = 0.0, 0.0, [], []
    for increment in [1e-4] * 50 + [-1e-4] * 60:
        mean, _, _, work, opening = (a[0] for a in return_map(mean + BULK * increment, 0.0, constants, opening))
        stresses.append(mean)
        works.append(work)
    assert max(stresses) == pytest.approx(apex, rel=1e-12)
    assert np.all(np.array(works) >= 0.0) and sum(works) > 0.0
    closing = np.array(stresses[51:])
    assert np.all(np.diff(closing) <= 1e-9) and np.sum(closing == 0.0) > 40
    # all 5e-3 of extension are taken back, then 1e-3 of compression remain, as in an elastic material
    assert opening == 0.0 and mean == pytest.approx(-BULK * 1e-3, rel=1e-6)


@pytest.mark.parametrize("sigma_m", [-1.0, 0.0])
def test_dilatancy_uses_up_what_is_open_before_it_builds_pressure(sigma_m):
    """c = 0, open: shear meets no resistance. The opening falls by eta_bar d_lambda, and only what dilatancy exceeds
    it by is compressed: p = K (eta_bar d_lambda - opening), with the stress on the cone.

    Strains: sqrt(J2) falls by G d_lambda and d_eps^2 = d_lambda^2/3 + 2/9 (eta_bar d_lambda)^2; work is the stress
    on the plastic strain.
    """
    constants = material(psi=10.0)
    opening = 1e-3
    left = opening + sigma_m / BULK
    for share in (0.3, 0.999, 1.001, 5.0):
        trial = share * left * SHEAR / constants.eta_bar  # shear strain whose dilation is this share of what is open
        m, r, d_eps, work, opened = (a[0] for a in return_map(sigma_m, trial, constants, opening))
        d_lambda = (trial - r) / SHEAR
        dilation = constants.eta_bar * d_lambda
        assert d_eps == pytest.approx(math.sqrt(d_lambda**2 / 3 + 2 / 9 * dilation**2), rel=1e-9)
        assert work == pytest.approx(m * dilation + r * d_lambda, rel=1e-9, abs=1e-9)
        if share < 1:
            assert m == 0.0 and r == pytest.approx(0.0, abs=1e-9 * trial)
            assert opened == pytest.approx(left - dilation, rel=1e-9)
        else:
            assert opened == 0.0
            assert m == pytest.approx(-BULK * (dilation - left), rel=1e-9) and m < 0.0
            assert r == pytest.approx(-constants.eta * m, rel=1e-9)


def test_an_open_point_loses_its_opening_to_dilatancy_whatever_the_round_off():
    """At c = 0 the deviator returns to zero up to round-off of either sign; the opening must not depend on that."""
    constants = material(psi=5.0)
    root = np.random.default_rng(0).uniform(1.0, 1e4, 2000)
    opened = return_map(-1.0, root, constants, 1e-2)[4]
    left = 1e-2 - 1.0 / BULK - constants.eta_bar * root / SHEAR
    assert opened == pytest.approx(left, rel=1e-9)


REGIMES = {  # psi [degrees], c [Pa]; then of n random numbers a, b, c in (0, 1): sigma_m [Pa], sqrt(J2) [Pa], opening
    "elastic": (5.0, 3e3, lambda a, b, c: (-1e4 - 1e4 * a, 4e3 * b, 0.0 * c)),
    "elastic, zero deviator": (5.0, 3e3, lambda a, b, c: (-1e4 - 1e4 * a, 0.0 * b, 0.0 * c)),
    "shear": (5.0, 3e3, lambda a, b, c: (-1e4 * a, 2e4 + 1e4 * b, 0.0 * c)),
    "apex": (5.0, 3e3, lambda a, b, c: (6e4 + 1e4 * a, 1e2 * b, 1e-3 * c)),
    "cohesionless apex": (0.0, 0.0, lambda a, b, c: (1e2 + 1e4 * a, 1e2 + 1e4 * b, 1e-3 * c)),
    "closing fully": (5.0, 0.0, lambda a, b, c: (-1e4 - 1e4 * a, 1e4 * b, 1e-3 * c)),
    "closing partly": (5.0, 3e3, lambda a, b, c: (-1e3 * a - 1.0, 2e3 * b, 1e-3 + 1e-3 * c)),
    "open with dilatancy": (5.0, 0.0, lambda a, b, c: (-1e3 * a - 1.0, 1.0 + 1e4 * b, 2e-3 + 1e-3 * c)),
    "open, dilatancy and cohesion": (5.0, 3e3, lambda a, b, c: (-1e3 * a - 1.0, 4e3 + 1e4 * b, 3e-3 + 1e-3 * c)),
    "open, used up by dilatancy": (5.0, 3e3, lambda a, b, c: (-50.0 * a - 1.0, 1e5 + 1e4 * b, 1e-4 + 1e-4 * c)),
}


@pytest.mark.parametrize("regime", REGIMES)
def test_slopes_are_the_derivatives_of_the_return(regime):
    """Central differences of return_map at random states; a step within which the regime changes is left out.

    The returned invariants are linear within a regime, so what remains is round-off.
    """
    psi, cohesion, states = REGIMES[regime]
    constants, step = material(psi=psi, cohesion=cohesion), 1e-2
    mean, root, opening = states(*np.random.default_rng(2).random((3, 500)))

    def returned_to(mean, root):
        return np.array(return_map(mean, root, constants, opening)[:2])

    slopes = return_slopes(mean, root, constants, opening)
    one_sided = root < step  # sqrt(J2) has no negative side
    along_m = (returned_to(mean + step, root) - returned_to(mean - step, root)) / (2 * step)
    behind = np.where(one_sided, root, root - step)
    along_r = (returned_to(mean, root + step) - returned_to(mean, behind)) / (root + step - behind)
    wrong = np.abs(np.array([along_m[0], along_r[0], along_m[1], along_r[1]]) - slopes).max(axis=0) > 1e-6
    assert wrong.mean() < 0.005  # a kink within the step


@pytest.mark.parametrize("psi", [0.0, 5.0, 20.0])
@pytest.mark.parametrize("cohesion", [0.0, 3e3])
def test_stress_and_opening_are_continuous_where_the_opening_closes(psi, cohesion):
    """Across sigma_m = -K opening (closed by compression) and eta_bar d_lambda = opening (closed by dilatancy)."""
    constants, opening, tiny = material(psi=psi, cohesion=cohesion), 1e-3, 1e-6
    for root in (0.0, 1e3, 1e4, 1e5):
        both = np.array(return_map(-BULK * opening + np.array([-tiny, tiny]), root, constants, opening))
        assert both[:2, 0] == pytest.approx(both[:2, 1], abs=10 * tiny)
        assert both[4, 0] == pytest.approx(both[4, 1], abs=10 * tiny / BULK)
    if psi > 0:
        root = constants.xi + SHEAR * (opening - 1.0 / BULK) / constants.eta_bar
        both = np.array(return_map(-1.0, root + np.array([-tiny, tiny]), constants, opening))
        assert both[:2, 0] == pytest.approx(both[:2, 1], abs=10 * tiny)
        assert both[4] == pytest.approx(0.0, abs=10 * tiny / SHEAR)


@pytest.mark.parametrize("psi", [0.0, 5.0])
def test_stress_is_continuous_where_an_open_point_turns_from_closing_to_opening(psi):
    """Across sigma_m = 0 while open and sheared, c = 0: no pressure on either side as long as something is open."""
    constants, tiny = material(psi=psi), 1e-6
    both = np.array(return_map(np.array([-tiny, tiny]), 1e4, constants, 1e-2))
    assert both[0] == pytest.approx(0.0, abs=10 * tiny)
    assert both[1] == pytest.approx(0.0, abs=10 * tiny)
    assert both[4, 0] == pytest.approx(both[4, 1], rel=1e-6)


def test_without_friction_the_cone_is_a_cylinder():
    """phi = 0: strength c whatever the pressure (Tresca's radius in plane strain), no apex."""
    constants = material(phi=0.0, cohesion=5e3, cone="plane_strain")
    mean, root, *_ = return_map([-1e6, 0.0, 1e6], [1e5, 1e5, 1e3], constants)
    assert mean == pytest.approx([-1e6, 0.0, 1e6], abs=0)
    assert root == pytest.approx([5e3, 5e3, 1e3], rel=1e-12)
