"""The model of a step on many ranks: its halos against those that the solver has, its limits against closed forms."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compare.bench.model import EXCHANGES, SHARED_PLANES, Link, Machine, Plan, divide, predict, quarter_column
from compare.bench.scaling import AGREES, this_machine, wider
from compare.bench.worker import column
from explicit.solver import ExplicitSolver
from mpm.domains import Halo, cut_plan, owner_of, shared_pencils
from mpm.gimp import HALF_LENGTH_IN_CELLS

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "benchmarks" / "results" / "scaling_cpu.csv"
PREDICTED = TABLE.with_name("scaling_predicted.csv")
FREE = Link(0.0, float("inf"))  # carries everything in no time


class Together:
    """Stands for the communicator of ranks of which `pencils` is all that is ever asked: one list for each."""

    def __init__(self, rank, pencils):
        self.rank, self.pencils = rank, pencils

    def allgather(self, _):
        return self.pencils


def halos(pencils):
    """The halo of each rank, from what each stores."""
    ranks = [Together(rank, pencils) for rank in range(len(pencils))]
    return [
        Halo(shared_pencils(mine, comm), int((mine[:, 3] - mine[:, 2]).sum()), comm)
        for mine, comm in zip(pencils, ranks, strict=True)
    ]


def stored_by(columns, height):
    """Pencils (m, 5) that are stored for material on `columns` (n, 2) that is `height` cells high: see `Halo`."""
    reach = np.arange(SHARED_PLANES + 1) - 1
    reached = np.unique((columns[:, None, None] + np.stack(np.meshgrid(reach, reach), -1)).reshape(-1, 2), axis=0)
    low, nodes = np.zeros(len(reached), int), height + SHARED_PLANES
    return np.column_stack([reached, low, low + nodes, np.arange(len(reached)) * nodes])


@pytest.mark.parametrize(("p", "q"), [(2, 1), (2, 2), (3, 3), (4, 2)])
def test_a_lattice_of_equal_rectangles_shares_what_the_model_says(p, q):
    """To the node, on the rank with most neighbours: sides of 12 p and 12 q cells, 10 high."""
    side, height = 12, 10
    square = np.argwhere(np.ones((side, side)))
    blocks = [np.add(square, (side * i, side * j)) for i in range(p) for j in range(q)]
    found = halos([stored_by(block, height) for block in blocks])
    most = max(found, key=lambda halo: len(halo.peers))
    said = divide(Plan(float(side * side * p * q), height), p * q)
    said = said._replace(a=side, b=side)  # `divide` takes a square plan
    assert (said.peers, said.shared) == (len(most.peers), len(most.nodes))
    assert said.sent == sum(len(at) for _, at in most.peers)
    assert said.stored == len(most.counted)


@pytest.mark.parametrize("ranks", [2, 4, 16])
def test_a_columns_domains_are_near_the_models(ranks):
    """A quarter disc is no square, and recursive bisection's rectangles are not equal: within a quarter."""
    body = column(0.5, 20, "float64")
    start = np.floor(body.x[:, :2] / body.scene.grid.cell - HALF_LENGTH_IN_CELLS).astype(int)
    owner = owner_of(start, cut_plan(*np.unique(start, axis=0, return_counts=True), ranks))
    solvers = [ExplicitSolver(replace(body, x=body.x[owner == rank])) for rank in range(ranks)]
    found = halos([solver.grid.pencils() for solver in solvers])
    said = divide(quarter_column(len(body.x), 0.5), ranks)
    assert max(len(halo.nodes) for halo in found) == pytest.approx(said.shared, rel=0.25)
    assert max(sum(len(at) for _, at in halo.peers) for halo in found) == pytest.approx(said.sent, rel=0.25)
    assert max(solver.grid.stored for solver in solvers) == pytest.approx(said.stored, rel=0.25)
    assert np.bincount(owner).max() * ranks / len(owner) < said.unevenness + 0.03


def test_a_column_holds_its_points():
    plan = quarter_column(25_133, 0.5)  # 2 pi 0.5 R^3 of them at R = 20
    assert plan.area == pytest.approx(np.pi / 4 * 20**2, rel=1e-4)
    assert plan.height == pytest.approx(10, rel=1e-4)


def test_one_rank_takes_its_own_time_and_tells_nobody():
    said = predict(1e6, 0.5, Machine(1, 1, 4e6, 0.0, Link(1e-6, 1e9), Link(1e-5, 1e9), 1e-5, 1e9))
    assert said.seconds == pytest.approx(1e6 / 4e6)
    assert (said.exchange, said.agreement, said.messages, said.sent_bytes) == (0.0, 0.0, 0, 0.0)
    assert said.efficiency == pytest.approx(1.0)


def test_where_messages_cost_nothing_ranks_lose_by_unevenness_and_nodes_held_twice_alone():
    machine = Machine(1, 4, 4e6, 0.0, FREE, FREE, 0.0, float("inf"))
    said = predict(1e6, 0.5, machine)
    assert said.exchange == said.agreement == 0.0
    domain = divide(quarter_column(1e6, 0.5), 4)
    assert 0.9 / domain.unevenness < said.efficiency < 1.0 / domain.unevenness
    assert predict(1e12, 0.5, machine).efficiency == pytest.approx(1.0, abs=2e-3)


def test_an_exchange_is_its_messages_and_its_bytes():
    """Two ranks, one cut: three messages of 13 numbers a node in all."""
    link = Link(1e-3, 1e6)
    said = predict(1e6, 0.5, Machine(1, 2, 4e6, 0.0, link, FREE, 0.0, float("inf")))
    sent = divide(quarter_column(1e6, 0.5), 2).sent
    assert (said.messages, said.sent_bytes) == (3, pytest.approx(sent * sum(EXCHANGES) * 8))
    assert said.exchange == pytest.approx(3e-3 + sent * 104 / 1e6)
    assert said.agreement == pytest.approx(2e-3)


def test_what_is_staged_goes_to_the_host_and_back():
    """Three exchanges a step of 13 numbers of four bytes a node; a rank alone has none."""
    gpus = Machine(1, 2, 1e9, 0.0, FREE, FREE, 0.0, float("inf"), real=4, staging=Link(1e-3, 1e6))
    sent = divide(quarter_column(1e6, 0.5), 2).sent
    assert predict(1e6, 0.5, gpus).exchange == pytest.approx(3e-3 + 2 * sent * 52 / 1e6)
    assert predict(1e6, 0.5, gpus._replace(ranks=1)).exchange == 0.0


def test_hosts_share_a_network_for_what_leaves_them():
    slow = Link(0.0, 1e6)
    said = predict(1e6, 0.5, Machine(4, 16, 4e6, 0.0, FREE, slow, 0.0, float("inf")))
    assert said.exchange == pytest.approx(divide(quarter_column(1e6, 0.5), 4).sent * 104 / 1e6)


def test_wider_columns_have_as_many_points_a_rank_and_the_same_height():
    for times in (2, 4, 9):
        aspect, cells = wider(20, times)
        assert aspect * cells == pytest.approx(10)
        assert len(column(aspect, cells, "float64").x) == pytest.approx(times * 25_120, rel=0.03)


@pytest.mark.skipif(not TABLE.is_file(), reason="the table of measurements is not in this checkout")
def test_the_committed_measurements_are_near_the_model():
    with open(TABLE, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    alone = {(row["aspect"], row["cells"]): float(row["point_steps_per_s"]) for row in rows if row["ranks"] == "1"}
    first = next(iter(alone))
    several = [row for row in rows if int(row["ranks"]) > 1]
    assert several
    for row in several:
        link = {name: float(row[name]) for name in ("latency", "bandwidth", "handling", "packing")}
        base = alone[(row["aspect"], row["cells"]) if row["kind"] == "strong" else first]
        said = predict(int(row["points"]), float(row["aspect"]), this_machine(int(row["ranks"]), base, link))
        assert said.rate == pytest.approx(float(row["point_steps_per_s"]), rel=AGREES)
        domain = divide(quarter_column(int(row["points"]), float(row["aspect"])), int(row["ranks"]))
        assert int(row["shared"]) == pytest.approx(domain.shared, rel=AGREES)


@pytest.mark.skipif(not PREDICTED.is_file(), reason="the table of predictions is not in this checkout")
def test_the_page_has_the_committed_predictions():
    page = (ROOT / "docs" / "speed.md").read_text(encoding="utf-8")
    with open(PREDICTED, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 9
    for row in rows:
        shares = [f"{float(row[name]):.0%}"[:-1] + " %" for name in ("efficiency", "exchange_share", "agreement_share")]
        ms, rate = float(row["ms_per_step"]), float(row["million_point_steps_per_s"])
        cells = [row["machine"], f"10^{len(row['points']) - 1}", f"{ms:,.{0 if ms > 1000 else 1}f}", f"{rate:,.0f}"]
        assert f"| {' | '.join(cells + shares)} |" in page
