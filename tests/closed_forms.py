"""Closed forms that more than one test holds a solver against."""

import numpy as np
from scipy.special import lambertw


def self_weight_stretch(young, density, gravity, depth):
    """Vertical stretch [-] at initial `depth` [m] below the top of a column that its own weight compacts, nu = 0.

    Hencky strain and Kirchhoff stress, tau = E ln(stretch), with no lateral strain, so that J = stretch and the Cauchy
    stress tau/J is also the force per initial area. It carries what lies above: E ln(stretch)/stretch = -rho g depth.
    With s = rho g depth/E that is s stretch exp(s stretch) = s: stretch = W(s)/s, W Lambert's function.
    `young` [Pa], initial `density` [kg/m3], `gravity` [m/s2].
    """
    s = density * gravity * np.asarray(depth, float) / young
    return np.exp(-lambertw(s).real)  # W(s)/s = exp(-W(s)), which also holds at s = 0


def self_weight_height(young, density, gravity, height):
    """Height [m] to which a column of initial `height` [m] is compacted (see `self_weight_stretch`).

    The stretch integrated over the depth: with s = W exp(W), ds = (1 + W) exp(W) dW and stretch = exp(-W) it is
    E/(rho g) times the integral of (1 + W) dW, that is (E/(rho g)) (W + W^2/2) at s = rho g height/E.
    """
    w = lambertw(density * gravity * np.asarray(height, float) / young).real
    return young / (density * gravity) * (w + 0.5 * w * w)
