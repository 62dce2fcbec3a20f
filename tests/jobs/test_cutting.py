"""How a sweep over any axes is cut: every lane in one tile, every line along the first axis in one piece."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnh.jobs.cutting import Piece, share, slab, tile_lanes, tile_shape
from tests.helpers.storage_jobs import job


@pytest.mark.parametrize(
    ("periods", "numbers", "lanes", "tile"),
    [
        (20, 32, 10**6, 65536),  # 2e6 lane-periods are 100,000 lanes
        (640, 512, 4096, 2048),
        (10_000, 64, 10**5, 256),  # 256 tiles are as many as need be: 390 lanes each
        (528, 16 * 65536 * 4, 10**5, 16),  # a lane of 34 MB
        (1e6, 64, 10**7, 512),  # no more than 16,384 tiles: 610 lanes each
    ],
)
def test_lanes_a_tile(periods, numbers, lanes, tile):
    assert tile_lanes(periods, numbers, lanes) == tile


@pytest.mark.parametrize(
    ("periods", "numbers", "lanes", "tile"),
    [
        (896, 16, 1 << 20, 65536),  # sixteen tiles: two batches for each of eight cards
        (896, 16, 4096, 2048),  # as on the host, where there are few lanes
        (896, 16 * 65536, 1 << 20, 16),  # no more bytes a tile than on the host
    ],
)
def test_lanes_a_tile_on_a_card(periods, numbers, lanes, tile):
    assert tile_lanes(periods, numbers, lanes, on_card=True) == tile


def test_pieces_cover_the_sweep():
    found = job().cutting.pieces()
    assert [(piece.begin, piece.end) for piece in found] == [((0,), (4,)), ((4,), (8,)), ((8,), (10,)), ((0,), (10,))]
    assert [piece.names for piece in found] == [("diagram",)] * 3 + [("doubling",)]
    assert job(independent=()).cutting.pieces() == [
        Piece(0, ("diagram",), (0,), (10,)),
        Piece(1, ("doubling",), (0,), (10,)),
    ]
    assert found[0].shape == (4,)
    assert found[0].lanes == 4


@pytest.mark.parametrize(
    ("sizes", "most", "shape"),
    [
        ((10,), 4, (4,)),
        ((10,), 40, (10,)),
        ((1024, 512), 4096, (8, 512)),
        ((1024, 512), 512, (1, 512)),
        ((1024, 512), 100, (1, 100)),
        ((3, 1024, 512), 1000, (1, 1, 512)),
        ((3, 7, 5), 50, (1, 7, 5)),
        ((3, 7, 5), 70, (2, 7, 5)),
        ((), 5, ()),
    ],
)
def test_shape_of_a_tile(sizes, most, shape):
    assert tile_shape(sizes, most) == shape


def test_two_axes_of_lanes():
    """The second whole, the first cut; doubling along the first at each point of the second."""
    found = job((("b", 5, False), ("a", 3, False)), tile=6).cutting.pieces()
    assert [(piece.begin, piece.end) for piece in found] == [
        ((0, 0), (2, 3)),
        ((2, 0), (4, 3)),
        ((4, 0), (5, 3)),
        ((0, 0), (5, 1)),
        ((0, 1), (5, 2)),
        ((0, 2), (5, 3)),
    ]
    assert [piece.names for piece in found] == [("diagram",)] * 3 + [("doubling",)] * 3
    assert [piece.number for piece in found] == list(range(6))
    assert found[0].lanes == 6


@pytest.mark.parametrize("first", [False, True], ids=["second is shared", "first is shared"])
def test_shared_axis(first):
    """Whatever its place, it is constant along a tile, and all tiles of a value of it come one after the other."""
    axes = (("d", 2, True), ("b", 5, False)) if first else (("b", 5, False), ("d", 2, True))
    found = job(axes, tile=3, order=("diagram",)).cutting.pieces()
    rows = [(0, 0, 3), (0, 3, 5), (1, 0, 3), (1, 3, 5)]
    assert [(piece.begin, piece.end) for piece in found] == [
        ((d, begin), (d + 1, end)) if first else ((begin, d), (end, d + 1)) for d, begin, end in rows
    ]


def test_rows_of_a_shared_axis():
    """Several values of it are in a tile that has all lanes of these, no more than asked for; else one is."""
    axes = (("b", 5, False), ("d", 7, True))
    tiles = [
        [
            (piece.begin[1], piece.end[1])
            for piece in dataclasses.replace(job(axes, tile, ("diagram",)).cutting, shared_values=rows).pieces()
        ]
        for tile, rows in ((14, 32), (40, 3), (14, 1))
    ]
    assert tiles == [[(0, 2), (2, 4), (4, 6), (6, 7)], [(0, 3), (3, 6), (6, 7)], [(d, d + 1) for d in range(7)]]
    cut = dataclasses.replace(job(axes, 4, ("diagram",)).cutting, shared_values=32).pieces()
    assert [piece.shape for piece in cut] == [(4, 1), (1, 1)] * 7


AXES = st.lists(st.tuples(st.integers(1, 6), st.booleans()), min_size=1, max_size=4).map(
    lambda drawn: tuple((f"axis{k}", size, shared) for k, (size, shared) in enumerate(drawn))
)


@settings(deadline=None, max_examples=300)
@given(AXES, st.integers(1, 40), st.integers(1, 5))
def test_every_lane_is_in_one_tile_and_in_one_line(axes, tile, rows):
    whole = dataclasses.replace(
        job(axes, tile, ("diagram", "doubling", "lyapunov"), ("diagram", "lyapunov")).cutting, shared_values=rows
    )
    pieces = whole.pieces()
    assert [piece.number for piece in pieces] == list(range(len(pieces)))
    for names in (("diagram", "lyapunov"), ("doubling",)):
        covered = np.zeros(whole.shape, int)
        for piece in pieces:
            if piece.names == names:
                covered[slab(whole.names, piece, whole.names)] += 1
        assert (covered == 1).all()
    for piece in pieces:
        assert piece.lanes == np.prod(piece.shape)
        if piece.names == ("doubling",):
            assert piece.shape == (axes[0][1],) + (1,) * (len(axes) - 1)
        else:
            assert piece.lanes <= tile
            of_shared = [size for size, (_, _, shared) in zip(piece.shape, axes, strict=True) if shared]
            own = [(size, axis[1]) for size, axis in zip(piece.shape, axes, strict=True) if not axis[2]]
            assert math.prod(of_shared) <= rows
            assert all(size == 1 for size in of_shared) or all(size == most for size, most in own)


@settings(deadline=None, max_examples=100)
@given(st.integers(1, 50), st.integers(1, 60))
def test_one_axis_is_cut_at_multiples_of_a_tile(size, tile):
    found = job((("drive", size, False),), tile, ("diagram",)).cutting.pieces()
    assert found == [
        Piece(k, ("diagram",), (at,), (min(at + tile, size),)) for k, at in enumerate(range(0, size, tile))
    ]


def test_slabs():
    """Where a variable lies: along axes in any place, with dimensions of its own, without an axis, without any."""
    piece = Piece(0, ("diagram",), (2, 5), (4, 6))
    whole = slice(None)
    assert slab(("b", "d", "strobe"), piece, ("b", "d")) == (slice(2, 4), slice(5, 6), whole)
    assert slab(("d", "level"), piece, ("b", "d")) == (slice(5, 6), whole)
    assert slab(("strobe",), piece, ("b", "d")) == (whole,)
    assert slab((), piece, ("b", "d")) == ()


@pytest.mark.parametrize("parts", [1, 2, 3, 7, 50])
def test_parts_share_all_pieces(parts):
    whole = job((("b", 100, False),), order=("diagram",)).cutting
    work = dict.fromkeys(range(25), 7.0)
    shares = [share(whole, (k, parts), work) for k in range(1, parts + 1)]
    assert [piece for share in shares for piece in share] == whole.pieces()
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


AXES_OF_PARTS = st.lists(st.integers(1, 5), min_size=1, max_size=3).map(
    lambda sizes: tuple((f"axis{k}", size, False) for k, size in enumerate(sizes))
)


@settings(deadline=None, max_examples=100)
@given(AXES_OF_PARTS, st.integers(1, 9), st.integers(1, 9), st.floats(0.0, 50.0))
def test_parts_share_lines_as_well(axes, tile, parts, line):
    """Each piece is in one part; no part does more than an equal share and one piece."""
    whole = job(axes, tile, ("diagram", "doubling")).cutting
    pieces = whole.pieces()
    work = {p.number: float(p.lanes) if p.names == ("diagram",) else line for p in pieces}
    shares = [share(whole, (k, parts), work) for k in range(1, parts + 1)]
    assert sorted(piece for share in shares for piece in share) == pieces
    loads = [sum(work[piece.number] for piece in share) for share in shares]
    assert max(loads) <= sum(work.values()) / parts + max(max(work.values()), tile) + max(line, 1.0)


def test_job_is_known_by_all_of_it():
    """Axes, their order and which are shared are part of what a job is; JSON keeps it."""
    one = job((("b", 3, False), ("d", 4, True)))
    others = [job((("d", 4, True), ("b", 3, False))), job((("b", 3, False), ("d", 4, False))), job(tile=5)]
    assert len({one.id, *(other.id for other in others)}) == 4
    assert one.cutting.lanes == 12
    assert json.loads(json.dumps(dataclasses.asdict(one)))["cutting"]["axes"] == [["b", 3, False], ["d", 4, True]]
