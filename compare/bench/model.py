"""What a step of the explicit solver takes on many ranks: a model of its work and of what ranks tell each other.

A column's plan is cut into equal rectangles. Where two adjoin, both store four planes of nodes: two that stencils of
either reach, and a margin of one on either side. Three times a step the sums of these nodes travel (see
`explicit.ranks.Domain.step`), and once all ranks agree on speeds and faults. A step takes as long as that of the rank
with most points.
"""

import math
from typing import NamedTuple

from explicit.kernels.sparse_grid import MARGIN
from mpm.gimp import NODES_PER_AXIS

SHARED_PLANES = NODES_PER_AXIS - 1 + 2 * MARGIN  # of nodes that two adjoining domains store both
POINTS_PER_CELL = 8
# Numbers that a step sends of each shared node: (m, m v) and (f, m theta) after the first scatter, (m, m v) again after
# the second, ln J after the third.
EXCHANGES = (8, 4, 1)
NODE_COST = 0.2  # time of a stored node over that of a point (benchmarks/results/bench_explicit_cpu.csv, 20 cells)


class Link(NamedTuple):
    """What carries messages: `latency` [s] of one, `bandwidth` [bytes/s] each way."""

    latency: float
    bandwidth: float

    def seconds(self, messages: float, size: float) -> float:
        """Time [s] of so many messages, one after the other, with `size` bytes in all."""
        return messages * self.latency + size / self.bandwidth


class Machine(NamedTuple):
    """Ranks that compute a step together: `hosts` of `ranks` each.

    `rate` [points/s] of one rank alone, and `start` [s], what a step of it takes without any points. `link`: between
    the ranks of a host; `network`: between hosts, shared by a host's ranks. `handling` [s] of a message beside what
    carries it, `packing` [bytes/s] at which what is sent is gathered and what has come is added. `real` [bytes]: a
    number's. `staging`: between a GPU and the host from whose memory messages go; its latency is that of a whole
    exchange (see `explicit.staged`).
    """

    hosts: int
    ranks: int
    rate: float
    start: float
    link: Link
    network: Link
    handling: float
    packing: float
    real: int = 8
    staging: Link = Link(0.0, math.inf)

    @property
    def all_ranks(self) -> int:
        """Ranks of all hosts."""
        return self.hosts * self.ranks


class Plan(NamedTuple):
    """A body in cells: `area` seen from above, `height`."""

    area: float
    height: float


class Domain(NamedTuple):
    """The part of a plan that a rank with most neighbours has: its sides [cells], the domains that adjoin each pair of
    its sides (0 to 2), and the height [nodes] of a pencil there."""

    a: float
    b: float
    beside_a: int
    beside_b: int
    height: float

    @property
    def peers(self) -> int:
        """Domains that share nodes with this one: beside it, and at its corners."""
        return self.beside_a + self.beside_b + self.beside_a * self.beside_b

    @property
    def stored(self) -> float:
        """Nodes stored."""
        return (self.a + SHARED_PLANES) * (self.b + SHARED_PLANES) * self.height

    @property
    def shared(self) -> float:
        """Nodes stored that other ranks store too."""
        alone_a = max(self.a + SHARED_PLANES * (1 - self.beside_a), 0.0)
        alone_b = max(self.b + SHARED_PLANES * (1 - self.beside_b), 0.0)
        return self.stored - alone_a * alone_b * self.height

    @property
    def sent(self) -> float:
        """Nodes whose sums go out in an exchange; one goes to each rank that stores it."""
        along = self.beside_a * (self.b + SHARED_PLANES) + self.beside_b * (self.a + SHARED_PLANES)
        corners = self.beside_a * self.beside_b * SHARED_PLANES
        return SHARED_PLANES * (along + corners) * self.height

    @property
    def unevenness(self) -> float:
        """Points of the heaviest domain over the mean: whole pencils put a cut half a pencil off at the most."""
        return (1.0 + min(self.beside_a, 1) * 0.5 / self.a) * (1.0 + min(self.beside_b, 1) * 0.5 / self.b)


class Prediction(NamedTuple):
    """A step on a machine: seconds in all and of each part, point-steps/s and over those of one rank alone and the
    number of ranks, bytes and messages that a rank sends."""

    seconds: float
    work: float
    exchange: float
    agreement: float
    rate: float
    efficiency: float
    sent_bytes: float
    messages: float


def quarter_column(points: float, aspect: float) -> Plan:
    """The plan of a quarter column of so many points, h0/r0 = `aspect`."""
    radius = (points / POINTS_PER_CELL / (math.pi / 4.0 * aspect)) ** (1.0 / 3.0)
    return Plan(math.pi / 4.0 * radius**2, aspect * radius)


def divide(plan: Plan, ranks: int) -> Domain:
    """Cut a plan, taken as a square, into `ranks` equal rectangles, as nearly square as their number allows."""
    q = max(each for each in range(1, math.isqrt(ranks) + 1) if ranks % each == 0)
    p, side = ranks // q, math.sqrt(plan.area)
    return Domain(side / p, side / q, min(p - 1, 2), min(q - 1, 2), plan.height + SHARED_PLANES)


def predict(points: float, aspect: float, machine: Machine) -> Prediction:
    """A step of a quarter column of so many points on a machine."""
    plan, ranks = quarter_column(points, aspect), machine.all_ranks
    domain, host = divide(plan, ranks), divide(plan, machine.hosts)
    alone = divide(plan, 1)
    point = 1.0 / machine.rate / (1.0 + NODE_COST * alone.stored / points)  # `rate` is that of points and their nodes

    def work(heaviest, nodes):
        return machine.start + point * (heaviest + NODE_COST * nodes)

    numbers = sum(EXCHANGES) * machine.real
    messages = len(EXCHANGES) * domain.peers
    own = domain.sent * numbers
    # A host's ranks share its network: all that leaves the host. What stays within goes over the link.
    exchange = machine.link.seconds(messages, own) + messages * machine.handling + 2.0 * own / machine.packing
    if ranks > 1:
        exchange += machine.staging.seconds(len(EXCHANGES), 2.0 * own)  # there and back
    if machine.hosts > 1:
        exchange += machine.network.seconds(messages, host.sent * numbers)
    agreement = 0.0
    if ranks > 1:  # a tree to one rank and back
        agreement = 2.0 * machine.link.latency * math.ceil(math.log2(machine.ranks))
        agreement += 2.0 * machine.network.latency * math.ceil(math.log2(machine.hosts))
    busy = work(points / ranks * domain.unevenness, domain.stored)
    seconds = busy + exchange + agreement
    return Prediction(
        seconds, busy, exchange, agreement, points / seconds,
        work(points, alone.stored) / seconds / ranks, own, messages,
    )  # fmt: skip
