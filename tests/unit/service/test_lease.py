import pytest

from needle_rig.errors import Aborted, BadInput
from needle_rig.service.api.lease import LEASE_S, Claim, Lease, Taken
from tests.values import now


class Rig:
    def __init__(self) -> None:
        self.now_s, self.moving = 100.0, False
        self.lease = Lease(lambda: self.moving, lambda: self.now_s)

    def claim(self, lease: str | None = None) -> Claim:
        self.now_s += 0.001
        return Claim(self.now_s, lease)


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_without_a_lease_everybody_commands(rig: Rig) -> None:
    rig.lease.check(rig.claim())
    assert rig.lease.holder is None


def test_one_commands_at_a_time(rig: Rig) -> None:
    own = rig.lease.take("anna", rig.claim())
    rig.lease.check(rig.claim(own))
    with pytest.raises(Taken, match="'anna' commands this rig"):
        rig.lease.check(rig.claim())
    with pytest.raises(Taken, match="'anna'"):
        rig.lease.take("bert", rig.claim())
    with pytest.raises(BadInput, match="take a new one"):
        rig.lease.check(rig.claim("guessed"))
    rig.lease.give_back(rig.claim("guessed"))
    assert rig.lease.holder == "anna"
    rig.lease.give_back(rig.claim(own))
    assert rig.lease.take("bert", rig.claim()) != own
    with pytest.raises(BadInput, match="take a new one"):
        rig.lease.check(rig.claim(own))


def test_it_ends_when_it_is_not_used_but_not_while_the_rig_is(rig: Rig) -> None:
    own = rig.lease.take("anna", rig.claim())
    rig.now_s += LEASE_S * 0.99
    rig.lease.check(rig.claim(own))
    rig.now_s += LEASE_S * 0.99
    assert rig.lease.take("anna", rig.claim(own)) == own
    rig.now_s += LEASE_S * 0.99
    rig.moving = True
    rig.now_s += 100 * LEASE_S
    assert now(rig.lease.holder) == "anna"
    rig.moving = False
    assert rig.lease.holder is None
    rig.lease.check(rig.claim())


def test_a_stop_ends_the_lease_and_all_that_was_asked_before(rig: Rig) -> None:
    own = rig.lease.take("anna", rig.claim())
    begun = rig.claim()
    rig.lease.stop()
    for before in (begun, Claim(rig.now_s), rig.claim(own), Claim(begun.begun_s, own)):
        with pytest.raises(Aborted):
            rig.lease.check(before)
        with pytest.raises(Aborted):
            rig.lease.take("anna", before)
    rig.lease.check(rig.claim())
    other = rig.lease.take("anna", rig.claim())
    rig.lease.check(rig.claim(other))
    with pytest.raises(Aborted):
        rig.lease.check(rig.claim(own))
