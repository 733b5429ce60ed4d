"""How fast a camera may send: the share of the link that is its own."""

from __future__ import annotations

import pytest

from edged.adapters.aravis.link import ETHERNET_BYTES, cameras_on_link, host_bps, packet_delay_s

GIGABIT = 1e9


def test_two_cameras_on_one_cable_take_turns() -> None:
    """After each packet as much time as the packet took: half of the link each."""
    packet_s = 8 * (9000 + ETHERNET_BYTES) / GIGABIT
    assert packet_s == pytest.approx(packet_delay_s(9000, GIGABIT, GIGABIT, 2))


@pytest.mark.parametrize(
    "camera_bps, host_bps_, cameras",
    [(GIGABIT, GIGABIT, 1), (GIGABIT, 10 * GIGABIT, 2), (1e8, GIGABIT, 2)],
    ids=["alone", "ten-gigabit-host", "slow-cameras"],
)
def test_who_does_not_fill_the_link_need_not_wait(camera_bps: float, host_bps_: float, cameras: int) -> None:
    """One camera on its own port, or links of the cameras that are slower than their share."""
    assert 0.0 == packet_delay_s(1500, camera_bps, host_bps_, cameras)


@pytest.mark.parametrize("packet_bytes", [576, 1500, 9000])
@pytest.mark.parametrize("cameras", [2, 3])
def test_together_they_fill_the_hosts_link_and_no_more(packet_bytes: int, cameras: int) -> None:
    """The mean rate of all of them is the link's."""
    bits = 8 * (packet_bytes + ETHERNET_BYTES)
    cycle_s = bits / GIGABIT + packet_delay_s(packet_bytes, GIGABIT, GIGABIT, cameras)

    assert GIGABIT == pytest.approx(cameras * bits / cycle_s)


def test_loopback_is_no_cable() -> None:
    """A virtual camera on this machine shares nothing."""
    assert 0 == cameras_on_link("127.0.0.1", "127.0.0.2")


def test_a_neighbour_that_is_not_known_is_taken_to_be_on_the_same_link() -> None:
    """Rather half the speed than lost packets; without a neighbour there is nobody to share with."""
    assert 2 == cameras_on_link("NO-SUCH-SERIAL", "NO-SUCH-OTHER")
    assert 1 == cameras_on_link("NO-SUCH-SERIAL", "")


def test_a_port_that_does_not_tell_its_speed_counts_as_gigabit() -> None:
    """Loopback has no speed."""
    assert GIGABIT == host_bps("127.0.0.1")
