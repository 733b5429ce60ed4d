"""The rate at which a camera may send: its share of the link."""

from __future__ import annotations

from pathlib import Path

import pytest

from edged.adapters.aravis.link import (
    ETHERNET_BYTES,
    USB_SHARE,
    cameras_on_link,
    host_bps,
    packet_delay_s,
    usb_bytes_per_second,
)

GIGABIT = 1e9


def test_two_cameras_on_one_cable_take_turns() -> None:
    """Two cameras on one cable wait after each packet as long as the packet took."""
    packet_s = 8 * (9000 + ETHERNET_BYTES) / GIGABIT
    assert packet_s == pytest.approx(packet_delay_s(9000, GIGABIT, GIGABIT, 2))


@pytest.mark.parametrize(
    "camera_bps, host_bps_, cameras",
    [(GIGABIT, GIGABIT, 1), (GIGABIT, 10 * GIGABIT, 2), (1e8, GIGABIT, 2)],
    ids=["alone", "ten-gigabit-host", "slow-cameras"],
)
def test_who_does_not_fill_the_link_need_not_wait(camera_bps: float, host_bps_: float, cameras: int) -> None:
    """A camera on its own port, or slower than its share, has no delay."""
    assert 0.0 == packet_delay_s(1500, camera_bps, host_bps_, cameras)


@pytest.mark.parametrize("packet_bytes", [576, 1500, 9000])
@pytest.mark.parametrize("cameras", [2, 3])
def test_together_they_fill_the_hosts_link_and_no_more(packet_bytes: int, cameras: int) -> None:
    """The mean rate of all cameras is the link's."""
    bits = 8 * (packet_bytes + ETHERNET_BYTES)
    cycle_s = bits / GIGABIT + packet_delay_s(packet_bytes, GIGABIT, GIGABIT, cameras)

    assert GIGABIT == pytest.approx(cameras * bits / cycle_s)


def test_loopback_is_no_cable() -> None:
    """A virtual camera on this machine shares no link."""
    assert 0 == cameras_on_link("127.0.0.1", "127.0.0.2")


def test_a_neighbour_that_is_not_known_is_taken_to_be_on_the_same_link() -> None:
    """An unknown neighbour counts as on the same link; without a neighbour nothing is shared."""
    assert 2 == cameras_on_link("NO-SUCH-SERIAL", "NO-SUCH-OTHER")
    assert 1 == cameras_on_link("NO-SUCH-SERIAL", "")


def test_a_port_that_does_not_tell_its_speed_counts_as_gigabit() -> None:
    """A port without a known speed counts as gigabit."""
    assert GIGABIT == host_bps("127.0.0.1")


def test_two_usb_cameras_behind_one_controller_get_half_of_it_each(tmp_path: Path) -> None:
    """Two USB cameras behind one controller get half of the slower port each, also behind a hub; one alone
    has no limit."""
    listed = tmp_path / "devices"
    listed.mkdir()
    places = {
        "pci/0000:00:14.0/usb2/2-1": ("LEFT", "5000"),
        "pci/0000:00:14.0/usb2/2-2/2-2.4": ("HUB", "10000"),
        "pci/0000:03:00.0/usb4/4-1": ("CARD", "5000"),
        "pci/0000:00:14.0/usb2/2-3": ("BROKEN", "fast"),
    }
    for path, (serial, speed) in places.items():
        folder = tmp_path / path
        folder.mkdir(parents=True)
        (folder / "serial").write_text(f"{serial}\n")
        (folder / "speed").write_text(f"{speed}\n")
        (listed / folder.name).symlink_to(folder)

    half = USB_SHARE * 5e9 / 8 / 2
    assert half == usb_bytes_per_second("LEFT", "HUB", listed) == usb_bytes_per_second("HUB", "LEFT", listed)
    assert 175e6 == pytest.approx(half)
    for neighbour in ("CARD", "", "NOBODY", "BROKEN"):
        assert usb_bytes_per_second("LEFT", neighbour, listed) is None
    assert usb_bytes_per_second("LEFT", "HUB", tmp_path / "none") is None
