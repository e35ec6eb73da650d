"""The Drucker-Prager law in its two invariants against closed forms: the nodes' pressure law and the return map."""

import dataclasses
import math

import numpy as np
import pytest
import warp as wp

from compare.hard.law import LAW, SAND, return_map
from mpm.devices import KERNEL_OPTIONS, start_warp
from mpm.scene import Material

start_warp()
MODULE = "repose_test_law"
VEC6 = wp.types.vector(6, wp.float64)
wp.set_module_options(KERNEL_OPTIONS, module=wp.get_module(MODULE))


@wp.kernel(module=MODULE)
def sloped(
    sigma_m: wp.array(dtype=wp.float64),
    gap: wp.array(dtype=wp.float64),
    root_j2: wp.array(dtype=wp.float64),
    material: LAW.Material,
    out: wp.array(dtype=VEC6),
):
    p = wp.tid()
    mean_m, mean_g, mean_r, root_m, root_g, root_r = LAW.return_slopes(
        sigma_m[p], gap[p], root_j2[p], LAW.LawState(), material
    )
    out[p] = VEC6(mean_m, mean_g, mean_r, root_m, root_g, root_r)


@wp.kernel(module=MODULE)
def borne(theta: wp.array(dtype=wp.float64), material: LAW.Material, out: wp.array(dtype=wp.vec3d)):
    i = wp.tid()
    out[i] = wp.vec3d(
        LAW.node_law(theta[i], material), LAW.node_slope(theta[i], material), LAW.node_gap(theta[i], material)
    )


def on_device(values):
    return wp.array(np.asarray(values, float), dtype=wp.float64, device="cpu")


def return_slopes(sigma_m, gap, root_j2, constants):
    """(6, n): derivatives of the returned mean stress, then of the returned sqrt(J2), over sigma_m, K gap, root_j2."""
    out = wp.zeros(len(sigma_m), dtype=VEC6, device="cpu")
    inputs = [*map(on_device, (sigma_m, gap, root_j2)), LAW.pack(constants), out]
    wp.launch(sloped, len(sigma_m), inputs=inputs, device="cpu")
    return out.numpy().T


def pressure_law(theta, constants):
    """(3, n) of nodes at volume strain `theta` (n,) [-]: mean stress [Pa], its slope over K [-], what is open [-]."""
    out = wp.zeros(len(theta), dtype=wp.vec3d, device="cpu")
    wp.launch(borne, len(theta), inputs=[on_device(theta), LAW.pack(constants), out], device="cpu")
    return out.numpy().T


def node_law(theta, constants):
    """Mean stress [Pa] of nodes at volume strain `theta` (n,) [-]."""
    return pressure_law(theta, constants)[0]


def sand(psi=0.0, cohesion=0.0, **changes):
    """Constants of the paper's sand with another dilatancy angle [degrees], cohesion [Pa] or key of a scene file."""
    return Material(**(SAND | {"dilatancy_angle": psi, "cohesion": cohesion} | changes)).constants()


def apex_of(constants):
    """Mean stress xi/eta [Pa] that an open node bears."""
    return constants.xi / constants.eta


# The pressure law of a node

KINDS = pytest.mark.parametrize("cohesion", [0.0, 1e3])


@KINDS
def test_a_node_is_elastic_up_to_the_apex_and_bears_no_more(cohesion):
    """sigma = K theta below theta = xi/(eta K), xi/eta = c cot(phi) beyond it, however far it opens."""
    law = sand(cohesion=cohesion)
    apex = cohesion / math.tan(math.radians(SAND["friction_angle"]))
    assert law.opens_at == pytest.approx(apex / law.bulk, rel=1e-14)
    below = law.opens_at - np.geomspace(1e-12, 0.5, 40)
    assert node_law(below, law) == pytest.approx(law.bulk * below, rel=1e-15)
    assert node_law([1e-2, 1.0, 1e6], law) == pytest.approx(apex, rel=1e-14, abs=0.0)


@KINDS
def test_the_slope_of_a_node_is_the_derivative_of_its_stress(cohesion):
    """Central differences on either side of the apex; what the stress does not follow is open."""
    law = sand(cohesion=cohesion)
    theta = law.opens_at + np.array([-1e-2, -1e-5, 1e-5, 1e-2])
    stress, slope, gap = pressure_law(theta, law)
    ahead, behind = node_law(theta + 1e-7, law), node_law(theta - 1e-7, law)
    assert slope == pytest.approx((ahead - behind) / (2e-7 * law.bulk), abs=1e-7)
    assert gap == pytest.approx(theta - stress / law.bulk, abs=1e-15)


@KINDS
def test_what_a_node_opens_must_close_before_it_bears_pressure(cohesion):
    """A loop of volume strain, opened by 2 % and closed again: the same stress on the way back as on the way out."""
    law = sand(cohesion=cohesion)
    out = np.linspace(-1e-3, 2e-2, 50)
    stress = node_law([*out, *out[::-1]], law)
    assert np.array_equal(stress[:50], stress[:49:-1])
    assert stress[-1] == pytest.approx(-1e-3 * law.bulk, rel=1e-15)
    still_open = stress[50:][out[::-1] > law.opens_at]
    assert len(still_open) > 40 and still_open == pytest.approx(apex_of(law), rel=1e-14, abs=0.0)


@pytest.mark.parametrize("changes", [{"friction_angle": 0.0, "cohesion": 5e3}, {"model": "elastic"}])
def test_without_an_apex_a_node_bears_any_tension(changes):
    """phi = 0 (eta = 0: a cylinder) and an elastic material."""
    theta = np.array([-0.1, 0.0, 1e-6, 0.1, 1e3])
    law = sand(**changes)
    assert node_law(theta, law) == pytest.approx(law.bulk * theta, rel=1e-15)


# The return map

RANDOM = np.random.default_rng(1)


def states(law, count=200):
    """Trial states outside the cone of `law`: sigma_m up to its apex, sqrt(J2) up to 20 kPa above the cone [Pa]."""
    sigma_m = apex_of(law) - RANDOM.uniform(0.0, 2e4, count)
    return sigma_m, law.xi - law.eta * sigma_m + RANDOM.uniform(1.0, 2e4, count)


@KINDS
@pytest.mark.parametrize("cone", ["inner", "outer", "plane_strain"])
def test_without_dilatancy_the_deviator_returns_at_the_pressure_of_the_nodes(cohesion, cone):
    """psi = 0: mean stress unchanged, sqrt(J2) = xi - eta sigma_m; the plastic strain is a shear of
    d_lambda = (sqrt(J2)_trial - sqrt(J2))/G, so d_eps = d_lambda/sqrt(3). A gap in the nodes makes no difference.
    """
    law = sand(cohesion=cohesion, cone=cone)
    sigma_m, trial = states(law)
    for gap in (0.0, 1e-2):
        mean, root, dilation, d_eps, work = return_map(sigma_m, gap, trial, law)
        assert np.array_equal(mean, sigma_m) and np.all(dilation == 0.0)
        assert root == pytest.approx(law.xi - law.eta * sigma_m, rel=1e-12, abs=1e-11)
        d_lambda = (trial - root) / law.shear
        assert d_eps == pytest.approx(d_lambda / math.sqrt(3.0), rel=1e-12)
        assert work == pytest.approx(root * d_lambda, rel=1e-12, abs=1e-14)


@KINDS
@pytest.mark.parametrize("psi", [5.0, 37.55])
def test_dilatancy_of_closed_nodes_builds_pressure(cohesion, psi):
    """psi > 0, no gap: d_lambda = f/(G + K eta eta_bar) takes the stress along (K eta_bar, G) to the cone.

    Linear elasticity: the energy that the stress loses is the plastic work and the energy of the plastic strain,
    K/2 dilation^2 + G/2 d_lambda^2. The work is d_lambda (xi - (eta - eta_bar) sigma_m): none at psi = phi, c = 0.
    """
    law = sand(psi, cohesion)
    sigma_m, trial = states(law)
    mean, root, dilation, d_eps, work = return_map(sigma_m, 0.0, trial, law)
    d_lambda = (trial + law.eta * sigma_m - law.xi) / (law.shear + law.bulk * law.eta * law.eta_bar)
    assert mean == pytest.approx(sigma_m - law.bulk * law.eta_bar * d_lambda, rel=1e-12, abs=1e-9)
    assert root == pytest.approx(law.xi - law.eta * mean, rel=1e-12, abs=1e-9)
    assert dilation == pytest.approx(law.eta_bar * d_lambda, rel=1e-12)
    assert d_eps == pytest.approx(np.sqrt(d_lambda**2 / 3.0 + 2.0 / 9.0 * dilation**2), rel=1e-12)
    energy = [m**2 / (2.0 * law.bulk) + r**2 / (2.0 * law.shear) for m, r in ((sigma_m, trial), (mean, root))]
    of_plastic_strain = 0.5 * law.bulk * dilation**2 + 0.5 * law.shear * d_lambda**2
    assert energy[0] - energy[1] == pytest.approx(work + of_plastic_strain, rel=1e-10)
    assert work == pytest.approx(d_lambda * (law.xi - (law.eta - law.eta_bar) * mean), rel=1e-9, abs=1e-9)


@KINDS
@pytest.mark.parametrize("share", [0.1, 0.999, 1.001, 20.0])
def test_dilatancy_fills_a_gap_before_it_builds_pressure(cohesion, share):
    """While eta_bar f/G is less than the gap (`share` < 1) the mean stress stays; what exceeds the gap is compressed,
    p = K (dilation - gap) more, with the stress on the cone.
    """
    law = sand(10.0, cohesion)
    sigma_m, gap = apex_of(law) - np.array([0.0, 1.0, 5e2, 1e4]), 1e-3
    f = share * gap * law.shear / law.eta_bar
    trial = f + law.xi - law.eta * sigma_m
    mean, root, dilation, d_eps, work = return_map(sigma_m, gap, trial, law)
    if share < 1.0:
        assert np.array_equal(mean, sigma_m)
        assert dilation == pytest.approx(share * gap, rel=1e-11)
    else:
        assert np.all(dilation > gap)
        assert mean == pytest.approx(sigma_m - law.bulk * (dilation - gap), rel=1e-9)
    assert root == pytest.approx(law.xi - law.eta * mean, rel=1e-9, abs=1e-11 * f)
    d_lambda = (trial - root) / law.shear
    assert dilation == pytest.approx(law.eta_bar * d_lambda, rel=1e-11)
    assert d_eps == pytest.approx(np.sqrt(d_lambda**2 / 3.0 + 2.0 / 9.0 * dilation**2), rel=1e-11)
    assert work == pytest.approx(mean * dilation + root * d_lambda, rel=1e-9, abs=1e-12 * f)


@KINDS
def test_the_return_is_continuous_where_the_gap_is_used_up(cohesion):
    """eta_bar f/G = gap, from both sides: mean stress and deviator of the gap's filling, all of the gap filled."""
    law, gap, tiny = sand(10.0, cohesion), 1e-3, 1e-6
    sigma_m = -1e3
    trial = gap * law.shear / law.eta_bar + law.xi - law.eta * sigma_m
    mean, root, dilation, *_ = return_map(sigma_m, gap, trial + np.array([-tiny, tiny]), law)
    assert mean == pytest.approx(sigma_m, abs=2.0 * law.bulk / law.shear * tiny)
    assert root == pytest.approx(law.xi - law.eta * sigma_m, abs=2.0 * law.bulk / law.shear * tiny)
    assert dilation == pytest.approx(gap, abs=tiny / law.shear)


@KINDS
@pytest.mark.parametrize("psi", [0.0, 10.0])
def test_open_nodes_bear_no_deviator(cohesion, psi):
    """At sigma_m = xi/eta as the nodes give it, round-off and all: any deviator returns to zero."""
    law = sand(psi, cohesion)
    sigma_m = node_law([0.5], law)
    trial = np.geomspace(1e-6, 1e6, 60)
    mean, root, dilation, *_ = return_map(sigma_m, 0.5, trial, law)
    assert np.all(mean == sigma_m)
    assert np.all(root >= 0.0) and np.all(root <= 1e-15 * (trial + 10.0 * cohesion))
    assert dilation == pytest.approx(law.eta_bar * trial / law.shear, rel=1e-6 if cohesion else 1e-14)


@KINDS
@pytest.mark.parametrize("psi", [0.0, 10.0])
def test_round_off_beyond_the_apex_gives_a_deviator_of_zero_and_no_less(cohesion, psi):
    law = sand(psi, cohesion)
    beyond = apex_of(law) + 1e-12 * np.array([0.5, 1.0, 50.0])
    trial = np.array([[1e-13], [1.0], [1e5]])
    returned = return_map(beyond, 0.5, trial, law)
    assert np.isfinite(returned).all()
    assert np.all(returned[0] == beyond)
    assert np.all(returned[1] >= 0.0) and np.all(returned[1] <= 1e-15 * (trial + 10.0 * cohesion))


@pytest.mark.parametrize("law", [sand(), sand(10.0, 1e3), sand(10.0), sand(model="elastic")])
def test_without_a_deviator_nothing_returns(law):
    """sqrt(J2) = 0: the mean stress as it is, no plastic strain and no NaN, at the apex and round-off beyond it too."""
    apex = apex_of(law) if law.plastic else 0.0
    sigma_m = np.array([-1e7, -1.0, 0.0, apex, apex + 1e-12])
    mean, *rest = return_map(sigma_m, [[0.0], [1e-2]], 0.0, law)
    assert np.all(mean == sigma_m) and np.all(np.array(rest) == 0.0)


@pytest.mark.parametrize("psi", [0.0, 10.0])
def test_stresses_that_underflow_return_no_nan(psi):
    """Down to the smallest number there is, where d_lambda loses its digits: G d_lambda is wrong by up to G 5e-324."""
    law, round_off = sand(psi), 1e-316
    tiny = np.array([0.0, 1e-300, 1e-310, 1e-316, 1e-317, 1e-320, 5e-324])
    sigma_m, gap, trial = -tiny[:, None, None], np.array([0.0, 1e-316, 1e-3])[:, None], np.array([*tiny, 1.0])
    mean, root, *plastic = return_map(sigma_m, gap, trial, law)
    assert np.isfinite(plastic).all()
    assert np.all(root >= 0.0) and np.all(root + law.eta * mean <= round_off + 1e-15 * trial)
    assert np.all(mean <= 0.0)


@pytest.mark.parametrize("psi", [0.0, 10.0])
def test_an_elastic_material_never_yields(psi):
    law = sand(psi, model="elastic")
    mean, root, *plastic = return_map([-1e9, 0.0, 1e9, 1e15], 0.0, [1e9, 1e12, 1e3, 1e15], law)
    assert np.array_equal(mean, [-1e9, 0.0, 1e9, 1e15]) and np.array_equal(root, [1e9, 1e12, 1e3, 1e15])
    assert np.all(np.array(plastic) == 0.0)


def test_without_friction_the_cone_is_a_cylinder():
    """phi = 0: strength c whatever the pressure or tension (Tresca's radius in plane strain)."""
    law = sand(friction_angle=0.0, cohesion=5e3, cone="plane_strain")
    mean, root, dilation, *_ = return_map([-1e6, 0.0, 1e6], 0.0, [1e5, 1e5, 1e3], law)
    assert np.array_equal(mean, [-1e6, 0.0, 1e6]) and np.all(dilation == 0.0)
    assert root == pytest.approx([5e3, 5e3, 1e3], rel=1e-12)


# Slopes of the return map. A regime: psi [degrees], c [Pa], and of random numbers a, b, g in (0, 1) how far sigma_m is
# below the apex, sqrt(J2) above the cone [Pa], and the gap [-].

REGIMES = {
    "elastic": (5.0, 3e3, lambda a, b, g: (1e4 + 1e4 * a, -5e3 * b - 1.0, 1e-3 * g)),
    "no dilatancy": (0.0, 3e3, lambda a, b, g: (1e4 * a, 1.0 + 1e4 * b, 1e-3 * g)),
    "no dilatancy, no cohesion": (0.0, 0.0, lambda a, b, g: (1e4 * a, 1.0 + 1e4 * b, 1e-3 * g)),
    "no dilatancy, at the apex": (0.0, 3e3, lambda a, b, g: (0.0 * a, 1.0 + 1e4 * b, 1e-3 * g)),
    "gap filled in part": (5.0, 3e3, lambda a, b, g: (1e4 * a, 1.0 + 1e4 * b, 1e-3 + 1e-3 * g)),
    "gap filled in part, at the apex": (5.0, 0.0, lambda a, b, g: (0.0 * a, 1.0 + 1e4 * b, 1e-3 + 1e-3 * g)),
    "gap used up": (5.0, 3e3, lambda a, b, g: (1e4 * a, 1e4 + 1e4 * b, 1e-4 * g)),
    "gap used up, at the apex": (5.0, 0.0, lambda a, b, g: (0.0 * a, 1e4 + 1e4 * b, 1e-4 * g)),
    "gap used up, none there": (5.0, 3e3, lambda a, b, g: (1e4 * a, 1.0 + 1e4 * b, 0.0 * g)),
}


@pytest.mark.parametrize("regime", REGIMES)
def test_slopes_are_the_derivatives_of_the_return(regime):
    """Differences of return_map at random states, central but at the ends of sigma_m <= xi/eta and gap >= 0.

    The returned invariants are linear within a regime, so what remains is round-off.
    """
    psi, cohesion, draw = REGIMES[regime]
    law, step = sand(psi, cohesion), 1e-2
    below, above, gap = draw(*np.random.default_rng(2).random((3, 100)))
    sigma_m = apex_of(law) - below
    root_j2 = law.eta * below + above
    _, _, dilation, d_eps, _ = return_map(sigma_m, gap, root_j2, law)
    if regime == "elastic" or regime.startswith("no"):
        assert np.all(dilation == 0.0) and np.all((d_eps > 0.0) != (regime == "elastic"))
    elif "in part" in regime:
        assert np.all((dilation > 0.0) & (dilation < gap))
    else:
        assert np.all(dilation > gap)

    def returned(below, k_gap, root_j2):
        return return_map(apex_of(law) - below, k_gap / law.bulk, root_j2, law)[:2]

    at, slopes = [below, law.bulk * gap, root_j2], return_slopes(sigma_m, gap, root_j2, law)
    for axis, sign in enumerate((-1.0, 1.0, 1.0)):
        low, high = list(at), list(at)
        low[axis], high[axis] = np.maximum(at[axis] - step, 0.0), at[axis] + step
        difference = (returned(*high) - returned(*low)) / (high[axis] - low[axis])
        assert sign * difference == pytest.approx(slopes[[axis, 3 + axis]], abs=1e-6)


def test_slopes_where_nothing_yields():
    """The identity, without a deviator and round-off beyond the apex too."""
    law = sand(10.0, 1e3)
    sigma_m = [-1e4, -1e4, apex_of(law), apex_of(law) + 1e-12]
    slopes = return_slopes(sigma_m, np.zeros(4), [1e3, 0.0, 0.0, 0.0], law)
    assert np.array_equal(slopes, np.tile([[1.0], [0.0], [0.0], [0.0], [0.0], [1.0]], 4))
    elastic = dataclasses.replace(law, plastic=False)
    assert np.array_equal(return_slopes([1e6], [0.0], [1e6], elastic)[:, 0], [1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
