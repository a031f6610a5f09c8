import math

from hypothesis import given
from hypothesis import strategies as st

from needle_rig.devices.link_clock import LinkClock

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
