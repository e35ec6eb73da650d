"""Abaqus input files -> points and cells: several parts, each placed by its instances, and several blocks of nodes."""

import re
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from mpm.errors import SceneError

# Keywords that make or move nodes and elements, or fetch them from elsewhere: to skip them would lose a part.
NOT_READ = ("INCLUDE", "SYSTEM", "NGEN", "NFILL", "NMAP", "NCOPY", "ELGEN", "ELCOPY")
VOLUME = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron"}
SURFACE = {3: "triangle", 4: "quad"}
# Families of element names, each followed by the number of nodes (C3D8R, S4R5, STRI3).
VOLUME_NAME = re.compile(r"(?:[A-Z]?C3D|SC|COH3D|CSS)(\d+)")
SURFACE_NAME = re.compile(r"(?:D?S|STRI|R3D|M3D|SFM3D|CP[SE]|CPEG|CAX|F3D)(\d)")
# Points and lines, which bound no body.
WITHOUT_FACES = re.compile(r"(?:B|PIPE|ELBOW|T[23]D|FRAME|R2D|RB[23]D|MASS|ROTARYI|SPRING|DASHPOT|CONN|GAP|ITT|JOINT)")


class Block(NamedTuple):
    """A keyword line, `name` and `options` in capitals, and the data lines under it."""

    name: str
    options: dict[str, str]
    lines: list[str]


class Part:
    """Nodes by number and elements by type, as they are listed."""

    def __init__(self):
        self.nodes, self.elements = [], []


def read_abaqus(path):
    """Points (n, 3) in the file's unit and cells, blocks (type, indices into the points), of an Abaqus input file.

    A part stands where each of its instances puts it (shift, then turn); where nothing is instanced, parts stand as
    they are listed. Raises SceneError for what is not read: included files, generated nodes, local systems, elements
    that are not known, and a part or node that the file does not have.
    """
    parts, instances = _collect(_blocks(path.read_text(encoding="utf-8", errors="replace")))
    points, cells, count = [np.empty((0, 3))], [], 0
    for name, place in instances or [(name, []) for name in parts]:
        if name not in parts:
            raise SceneError(f"an instance refers to part {name}, which the file does not have")
        numbers, its_points = _points_of(parts[name])
        points.append(_placed(its_points, place))
        cells += [(kind, count + _indices(numbers, corners)) for kind, corners in parts[name].elements]
        count += len(its_points)
    return np.concatenate(points), cells


def _blocks(text):
    """The keyword blocks of a file; comments and empty lines left out."""
    blocks = []
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("**")]
    open_keyword = False
    for line in lines:
        if line.startswith("*") or open_keyword:
            words = [word.strip().upper() for word in line.removeprefix("*").split(",")]
            if not open_keyword:
                blocks.append(Block(" ".join(words.pop(0).split()), {}, []))
            options = (word.partition("=") for word in words if word)
            blocks[-1].options.update({key.strip(): value.strip().strip('"') for key, _, value in options})
            open_keyword = line.endswith(",")  # goes on in the next line
        elif blocks:
            blocks[-1].lines.append(line)
    return blocks


def _collect(blocks):
    """Parts by name (a file without parts is one part) and instances (name of the part, data lines)."""
    parts, instances, part, at = {}, [], Part(), ""
    whole = part
    for block in blocks:
        if block.name in NOT_READ:
            raise SceneError(f"*{block.name} is not read; write the mesh with its nodes and elements in one file")
        if block.name == "PART":
            part, at = parts.setdefault(block.options.get("NAME", ""), Part()), "part"
        elif block.name == "ASSEMBLY":
            at = "assembly"  # nodes and elements here are reference points and connectors
        elif block.name == "INSTANCE":
            if "PART" not in block.options:
                raise SceneError("an *INSTANCE without a part of this file is not read")
            instances.append((block.options["PART"], block.lines))
            at = "instance"
        elif block.name in ("END PART", "END ASSEMBLY", "END INSTANCE"):
            at = "assembly" if block.name == "END INSTANCE" else ""
            part = whole
        elif block.name in ("NODE", "ELEMENT") and at != "assembly":
            if at == "instance":
                raise SceneError(f"an instance with nodes of its own (*{block.name}) is not read; put them in its part")
            if "INPUT" in block.options or "SYSTEM" in block.options:
                raise SceneError(f"*{block.name} with INPUT or SYSTEM is not read; write x, y, z in this file")
            part.nodes += block.lines if block.name == "NODE" else []
            if block.name == "ELEMENT" and (kind := _kind(block.options.get("TYPE", ""))):
                part.elements.append((kind[0], _table(block.lines, 1 + kind[1])[:, 1:]))
    return parts | ({"": whole} if whole.elements else {}), instances


def _kind(name):
    """Cell type and number of nodes of an Abaqus element; None for points and lines."""
    for pattern, kinds in ((VOLUME_NAME, VOLUME), (SURFACE_NAME, SURFACE)):
        if (found := pattern.match(name)) and int(found[1]) in kinds:
            return kinds[int(found[1])], int(found[1])
    if WITHOUT_FACES.match(name):
        return None
    known = "C3D4, C3D5, C3D6, C3D8, S3, S4 and their kin"
    raise SceneError(f"elements {name or 'without a TYPE'} are not read; save first-order elements ({known})")


def _table(lines, columns):
    """Whole numbers of data lines, `columns` an element; an element may go over several lines."""
    try:
        numbers = np.array([int(word) for line in lines for word in line.split(",") if word.strip()], dtype=np.int64)
        return numbers.reshape(-1, columns)
    except ValueError:
        raise SceneError("an *ELEMENT block does not have the nodes of its type, or is no list of numbers") from None


def _points_of(part):
    """Numbers (n,) and coordinates (n, 3) of a part's nodes, ordered by number; the last of a number counts."""
    nodes = {}
    try:
        for line in part.nodes:
            number, *coordinates = (line + ",,,").split(",")[:4]
            nodes[int(number)] = [float(word or 0.0) for word in map(str.strip, coordinates)]
    except ValueError:
        raise SceneError(f"a *NODE line is no list of numbers: {line[:60]}") from None
    numbers = np.array(sorted(nodes), dtype=np.int64)
    return numbers, np.array([nodes[number] for number in numbers], dtype=float).reshape(-1, 3)


def _indices(numbers, corners):
    index = np.searchsorted(numbers, corners)
    if np.any(index == len(numbers)) or np.any(numbers[index] != corners):
        raise SceneError("an element refers to a node that its part does not have")
    return index


def _placed(points, lines):
    """Points (n, 3) shifted by an instance's first data line, then turned about the axis of its second [degrees]."""
    try:
        shift, turn = [[float(word) for word in line.split(",") if word.strip()] for line in [*lines, "", ""]][:2]
    except ValueError:
        raise SceneError("the data lines of an *INSTANCE are no list of numbers") from None
    if shift:
        points = points + (shift + [0.0] * 3)[:3]
    if turn:
        if len(turn) != 7 or turn[:3] == turn[3:6]:
            raise SceneError("a turned *INSTANCE needs two points of its axis and an angle, seven numbers")
        start, end, angle = np.array(turn[:3]), np.array(turn[3:6]), turn[6]
        axis = (end - start) / np.linalg.norm(end - start)
        points = start + Rotation.from_rotvec(np.radians(angle) * axis).apply(points - start)
    return points
