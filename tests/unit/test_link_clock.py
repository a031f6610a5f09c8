import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.devices.link_clock import LinkClock
from needle_rig.devices.shortest_way import CRYSTAL_TOLERANCE, RC_TOLERANCE

PERIOD_S = 6.5536


class Node:
    """A node that samples every millisecond, and a host that hears it `delay_s` later."""

    def __init__(self, clock: LinkClock, start_s: float = 5.0, rate: float = 1.0) -> None:
        self.clock, self.start_s, self.rate = clock, start_s, rate
        self.count = 0

    def frame(self, time_s: float) -> tuple[int, float]:
        self.count += 1
        return self.count % 16, (self.start_s + time_s * self.rate) % PERIOD_S

    def send(self, time_s: float, delay_s: float = 0.0) -> bool:
        return self.clock.accept(*self.frame(time_s), time_s + delay_s)


def running(start_s: float = 5.0, rate: float = 1.0) -> Node:
    node = Node(LinkClock(PERIOD_S), start_s, rate)
    for index in range(100):
        node.send(index * 1e-3)
    assert node.clock.age_s(0.099) < 0.001
    return node


def test_the_age_is_infinite_before_the_first_reading() -> None:
    assert math.isinf(LinkClock(PERIOD_S).age_s(123.0))


def test_the_first_readings_count_once_they_agree_for_20_ms() -> None:
    node = Node(LinkClock(PERIOD_S))
    taken = [node.send(index * 1e-3) for index in range(40)]
    assert taken.index(True) == 20
    assert all(taken[20:])


def test_a_repeated_frame_is_no_news() -> None:
    node = running()
    frame = node.frame(0.1)
    assert node.clock.accept(*frame, 0.1)
    for late in range(1, 200):
        assert not node.clock.accept(*frame, 0.1 + late * 1e-3)
    assert node.clock.age_s(0.3) > 0.199


def test_a_counter_that_stands_still_is_no_news_though_the_clock_goes_on() -> None:
    node = running()
    counter, _ = node.frame(0.1)
    node.clock.accept(counter, 5.1, 0.1)
    assert not any(node.clock.accept(counter, 5.1 + n * 1e-3, 0.1 + n * 1e-3) for n in range(1, 300))


def test_a_clock_that_stands_still_is_no_news_though_the_counter_goes_on() -> None:
    node = running()
    assert node.clock.accept(7, 5.1, 0.1)
    assert not any(node.clock.accept(n % 16, 5.1, 0.1 + n * 1e-3) for n in range(8, 300))


def test_lost_frames_do_no_harm() -> None:
    node = running()
    for lost in (1, 3, 14, 40):
        node.count += lost
        start_s = 0.1 + lost * 0.01
        assert node.send(start_s)
    node.count += 15  # sixteen lost: the counter looks the same, the next frame is taken
    assert not node.send(0.6)
    assert node.send(0.601)


def test_a_node_that_starts_again_is_taken_back_within_25_ms() -> None:
    node = running()
    again = Node(node.clock, start_s=0.0)
    taken = [again.send(0.5 + index * 1e-3) for index in range(30)]
    assert taken.index(True) <= 25
    assert node.clock.age_s(0.53) < 0.002


def test_data_that_queue_up_on_the_way_grow_old_though_they_keep_coming() -> None:
    node = running()
    for index in range(100, 300):
        node.send(index * 1e-3, delay_s=(index - 100) * 1e-3)  # the link carries half of what is sent
    # The newest was sampled at 0.299 s and came at 0.498 s.
    assert node.clock.age_s(0.498) > 0.18


def test_old_data_in_one_lump_after_a_pause_are_no_news() -> None:
    node = running()
    lump_s = 1.1
    taken = [node.clock.accept(*node.frame(index * 1e-3), lump_s) for index in range(100, 300)]
    assert not any(taken)
    assert node.clock.age_s(lump_s) > 0.9
    assert node.send(1.101)
    assert node.clock.age_s(1.101) < 0.002


def test_a_clock_off_by_one_percent_is_followed_for_minutes() -> None:
    for rate in (0.99, 1.01):
        node = running(rate=rate)
        for index in range(100, 60_000, 3):
            assert node.send(index * 1e-3)
            assert node.clock.age_s(index * 1e-3) < 0.002


@given(st.lists(st.tuples(st.integers(0, 15), st.floats(0, PERIOD_S)), max_size=60), st.floats(1e-4, 0.01))
def test_random_frames_seldom_count_and_never_make_the_next_good_one_old(
    noise: list[tuple[int, float]], gap_s: float
) -> None:
    node = running()
    now_s = 0.1
    for counter, node_s in noise:
        now_s += gap_s
        node.clock.accept(counter, node_s, now_s)
        assert node.clock.age_s(now_s) >= 0.0
    back = [node.send(now_s + index * 1e-3) for index in range(1, 80)]
    assert any(back)
    assert node.clock.age_s(now_s + 0.079) < 0.3


def test_a_pause_of_several_turns_of_the_nodes_clock() -> None:
    node = running()
    for pause_s in (3.0, 6.5536, 20.0, 100.0):
        start_s = 0.1 + pause_s * 2
        for index in range(30):
            node.send(start_s + index * 1e-3)
        assert node.clock.age_s(start_s + 0.029) < 0.002


class Link:
    """A node of any rate behind a link with jitter, whose queue may begin to grow; it keeps the worst."""

    def __init__(self, rate_hz: float, jitter: str, rate: float, tolerance: float = RC_TOLERANCE) -> None:
        self.clock = LinkClock(PERIOD_S, tolerance)
        self.rate_hz, self.jitter, self.rate = rate_hz, jitter, rate
        self.random = random.Random(1)
        self.frames, self.node_s, self.now_s = 0, 5.0, 0.0
        self.hidden_s = self.overstated_s = 0.0

    def arrival_s(self, sent_s: float) -> float:
        """When a frame comes out of the adapter: at once, every 16 ms, or within 16 ms."""
        if self.jitter == "usb":
            return math.ceil(sent_s / 0.016) * 0.016
        return sent_s + (self.random.random() * 0.016 if self.jitter == "random" else 0.0)

    def run(self, for_s: float, growth: float = 0.0, warming_per_s: float = 0.0) -> "Link":
        begun_s = self.frames / self.rate_hz
        for _ in range(round(for_s * self.rate_hz)):
            sampled_s = self.frames / self.rate_hz
            queued_s = growth * (sampled_s - begun_s)
            self.rate += warming_per_s / self.rate_hz
            self.frames += 1
            self.node_s += (1.0 + self.rate) / self.rate_hz
            self.now_s = max(self.now_s, self.arrival_s(sampled_s + queued_s))
            self.clock.accept(self.frames, round(self.node_s % PERIOD_S, 6), self.now_s)
            if sampled_s > 0.1:
                said_s = self.clock.age_s(self.now_s)
                self.hidden_s = max(self.hidden_s, queued_s - said_s)
                self.overstated_s = max(self.overstated_s, said_s - (self.now_s - sampled_s))
        return self


JITTERS = ["none", "usb", "random"]


@given(st.floats(-0.02, 0.02), st.sampled_from([50.0, 100.0, 200.0]), st.sampled_from(JITTERS))
def test_a_healthy_link_is_never_said_older_than_it_is(rate: float, rate_hz: float, jitter: str) -> None:
    assert Link(rate_hz, jitter, rate).run(60.0).overstated_s < 0.01


@pytest.mark.parametrize("jitter", JITTERS)
@pytest.mark.parametrize("rate", [-0.02, 0.01, 0.02])
def test_a_healthy_link_is_not_said_older_after_hours(rate: float, jitter: str) -> None:
    assert Link(20.0, jitter, rate).run(2 * 3600.0).overstated_s < 0.01


@given(
    st.sampled_from([0.005, 0.01, 0.019, 0.03, 0.2]),
    st.floats(-0.02, 0.02),
    st.sampled_from([50.0, 100.0, 200.0]),
    st.sampled_from(["none", "usb"]),
    st.floats(10.5, 60.0),
)
def test_a_queue_that_begins_to_grow_hides_50_ms_at_most(
    growth: float, rate: float, rate_hz: float, jitter: str, healthy_s: float
) -> None:
    link = Link(rate_hz, jitter, rate).run(healthy_s)
    assert link.overstated_s < 0.01
    assert link.run(90.0, growth=growth).hidden_s < 0.05
    assert link.clock.age_s(link.now_s) > 0.25


@pytest.mark.parametrize("growth", [0.005, 0.01, 0.019])
def test_behind_a_crystal_a_queue_that_grows_from_the_first_frame_on_hides_little(growth: float) -> None:
    for rate in (-1e-4, 0.0, 1e-4):
        link = Link(100.0, "usb", rate, CRYSTAL_TOLERANCE)
        assert link.run(90.0, growth=growth).hidden_s < 0.05
        assert link.clock.age_s(link.now_s) > 0.25


def test_without_a_crystal_it_hides_the_tolerance_at_most() -> None:
    assert Link(100.0, "none", 0.0).run(60.0, growth=0.03).hidden_s < 0.02 * 60.0 + 0.01


@pytest.mark.parametrize("warming_per_s", [-20e-6, 20e-6])
@pytest.mark.parametrize("jitter", ["none", "usb"])
def test_a_node_that_warms_up_is_not_said_older(warming_per_s: float, jitter: str) -> None:
    link = Link(100.0, jitter, 0.0).run(20.0)
    link.run(120.0, warming_per_s=warming_per_s)
    assert link.run(300.0).overstated_s < 0.01


def test_a_queue_that_empties_again_is_forgotten() -> None:
    link = Link(100.0, "none", 0.001).run(20.0)
    link.run(15.0, growth=0.01)
    assert link.clock.age_s(link.now_s) == pytest.approx(0.15, abs=0.02)
    link.run(1.0)
    assert link.clock.age_s(link.now_s) < 0.01


def test_one_damaged_frame_that_seems_early_makes_none_of_the_others_old() -> None:
    link = Link(100.0, "none", 0.0).run(20.0)
    early_s = (link.node_s + 0.2) % PERIOD_S
    assert link.clock.accept(7, early_s, link.now_s + 0.005)
    link.overstated_s = 0.0
    assert link.run(60.0).overstated_s < 0.01
