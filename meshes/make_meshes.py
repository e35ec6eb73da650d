"""Make the meshes of this folder: `python meshes/make_meshes.py [--out DIR]`."""

import argparse
from pathlib import Path

import meshio
import numpy as np

RADIUS = 1.0  # r0 [m]
HEIGHT = 0.5  # h0 [m]: lambda0 = h0 / r0 = 0.5
REPOSE_SLOPE = 0.77  # tangent of the cone's angle of repose
SIDES = 128  # a multiple of 4: the planes x = 0 and y = 0 pass through vertices
LAYERS = 4  # of the volume mesh


def polygon(radius):
    """Corners (SIDES, 2) [m] of the regular polygon with the area of the circle of this radius [m]."""
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    circumradius = radius * np.sqrt(2.0 * np.pi / (SIDES * np.sin(2.0 * np.pi / SIDES)))
    return circumradius * np.column_stack([np.cos(angle), np.sin(angle)])


def at_height(corners, z):
    return np.column_stack([corners, np.full(len(corners), z)])


def cylinder():
    """Closed surface: the two rings, the centres of the base and of the top; wound outwards."""
    ring = polygon(RADIUS)
    points = np.vstack([at_height(ring, 0.0), at_height(ring, HEIGHT), [[0, 0, 0], [0, 0, HEIGHT]]])
    a = np.arange(SIDES)
    b = (a + 1) % SIDES
    base = np.column_stack([b, a, np.full(SIDES, 2 * SIDES)])
    top = np.column_stack([a + SIDES, b + SIDES, np.full(SIDES, 2 * SIDES + 1)])
    wall = np.vstack([np.column_stack([a, b, b + SIDES]), np.column_stack([a, b + SIDES, a + SIDES])])
    return meshio.Mesh(points, [("triangle", np.vstack([base, top, wall]))])


def cone():
    """Closed surface of the cone at repose that holds the cylinder's volume; wound outwards."""
    radius = np.cbrt(3.0 * RADIUS**2 * HEIGHT / REPOSE_SLOPE)
    ring = polygon(radius)
    points = np.vstack([at_height(ring, 0.0), [[0, 0, 0], [0, 0, REPOSE_SLOPE * radius]]])
    a = np.arange(SIDES)
    b = (a + 1) % SIDES
    base = np.column_stack([b, a, np.full(SIDES, SIDES)])
    slope = np.column_stack([a, b, np.full(SIDES, SIDES + 1)])
    return meshio.Mesh(points, [("triangle", np.vstack([base, slope]))])


def cylinder_volume():
    """The same cylinder in volume cells: wedges around the axis, hexahedra outside half the radius."""
    ring = polygon(RADIUS)
    section = np.vstack([[[0, 0]], 0.5 * ring, ring])
    points = np.vstack([at_height(section, z) for z in np.linspace(0.0, HEIGHT, LAYERS + 1)])
    a = 1 + np.arange(SIDES)
    b = 1 + (np.arange(SIDES) + 1) % SIDES
    triangles = np.column_stack([np.zeros(SIDES, dtype=int), a, b])
    quads = np.column_stack([a, a + SIDES, b + SIDES, b])
    return meshio.Mesh(points, [("wedge", extrude(triangles)), ("hexahedron", extrude(quads))])


def extrude(section):
    """Cells standing on the section's triangles or quads, layer by layer."""
    nodes = 1 + 2 * SIDES
    layers = [np.hstack([section, section + nodes]) + nodes * layer for layer in range(LAYERS)]
    return np.vstack(layers)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parent, help="folder to write to (default: this script's)"
    )
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    cylinder().write(out / "cylinder.stl", binary=True)
    cone().write(out / "cone.stl", binary=True)
    cylinder_volume().write(out / "cylinder_volume.vtu", binary=True)


if __name__ == "__main__":
    main()
