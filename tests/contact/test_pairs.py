"""Numbers and names of contact pairs in memory and in results."""

from __future__ import annotations

import numpy as np
import pytest

from piezomat.contact.pairs import Pairs

BODIES = ("a", "b", "c")
NAMED = Pairs(BODIES, ("b-a", "c-top"), {0: "b-a", 1: "c-top"}, ("floor", "lid"))
LISTED = Pairs(BODIES, None, {1: "a-b", 2: "a-c", 5: "b-c"}, ("floor", "lid"))
UNLISTED = Pairs(BODIES, None, {}, ("floor", "lid"))
PLANES = Pairs((), (), {}, ("floor", "lid"))


def test_a_pair_of_bodies_has_one_number_and_both_names() -> None:
    first, second = np.array([0, 2, 1, 1]), np.array([1, 0, 2, 1])
    numbers = LISTED.of_bodies(first, second)
    assert np.array_equal(numbers, LISTED.of_bodies(second, first))
    assert [LISTED.name(int(number)) for number in numbers] == ["a-b", "a-c", "b-c", "b-b"]
    assert [NAMED.name(number) for number in (0, 1)] == ["b-a", "c-top"]


@pytest.mark.parametrize("pairs", [NAMED, LISTED, UNLISTED], ids=["named", "listed", "unlisted"])
def test_results_give_every_pair_back_its_name(pairs: Pairs) -> None:
    numbers = np.array(list(pairs.listed) or [1, 2, 4, 5])
    written = pairs.in_results(numbers)
    assert [pairs.result_name(int(n)) for n in written] == [pairs.name(int(n)) for n in numbers]
    assert len(set(written.tolist())) == len(numbers) and written.max() < pairs.first_plane


@pytest.mark.parametrize("pairs", [NAMED, LISTED, UNLISTED, PLANES], ids=["named", "listed", "unlisted", "planes"])
def test_planes_come_after_the_pairs(pairs: Pairs) -> None:
    first = pairs.first_plane
    assert [pairs.result_name(number) for number in (first, first + 1)] == ["floor", "lid"]
    assert pairs.result_name(first + 2) == f"pair {first + 3}"
