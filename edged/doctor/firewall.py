"""Checks that the firewall lets images in.

A camera sends images from a port of its choice to one that Aravis chose, so a rule for the command port 3956
does not let them pass. Also, an answer to a broadcast belongs to no connection known to the firewall: such a
camera can be opened by its address, but is not found by its serial number.
"""

from __future__ import annotations

import contextlib
import ipaddress
import json
from collections.abc import Sequence
from typing import Any

from edged.doctor.findings import Check, CheckResult, ok, skip, warn
from edged.doctor.host import CAP_NET_RAW, has_capability, read, run

Rules = Sequence[dict[str, Any]]
"""Entries of `nft --json list ruleset`."""


def look_at_firewall(cameras: Sequence[tuple[str, str]]) -> Check:
    """Check that images can arrive. cameras : port of this host, and IP address or network, of each."""
    rules = _nft_rules()
    if rules is None:
        return _old_firewall()
    if accepts_by_default(rules):
        return ok("firewall", "drops nothing by default")
    places = accepted_places(rules)
    shut = [(port, address) for port, address in cameras if not _is_accepted(port, address, places)]
    if not cameras:
        return skip("firewall", "drops by default; where the cameras would be is not known")
    if not shut:
        return ok("firewall", "drops by default, and has rules that let the cameras in")
    port, _ = shut[0]
    packet_socket = has_capability(CAP_NET_RAW)
    consequence = "a camera is not found by its serial number"
    if not packet_socket:
        consequence += ", and sends no image that arrives"
    table = _input_chain(rules)
    return Check(
        "firewall",
        CheckResult.WARN if packet_socket else CheckResult.BAD,
        f"drops what no rule names, and none names {' or '.join(address for _, address in shut)}",
        consequence,
        f"sudo nft insert rule {table} iifname {port} meta l4proto udp accept"
        "   (and the same in /etc/nftables.conf; ufw: ufw allow in on "
        f"{port} proto udp; firewalld: firewall-cmd --permanent --zone=trusted --add-interface={port})",
    )


def accepts_by_default(rules: Rules) -> bool:
    """Whether a ruleset accepts packets that match no rule."""
    last: dict[tuple[str, str, str], Any] = {}
    for rule in (entry["rule"] for entry in rules if "rule" in entry):
        last[_place(rule, rule.get("chain"))] = rule.get("expr", [])
    for chain in _input_chains(rules):
        final = [part for part in last.get(_place(chain, chain.get("name")), []) if not _only_notes(part)]
        if chain.get("policy") == "drop" or (len(final) == 1 and final[0].keys() & {"drop", "reject"}):
            return False
    return True


def accepted_places(rules: Rules) -> set[str]:
    """Return what accepting rules match: ports of this host, addresses, networks."""
    places = set[str]()
    for rule in (entry["rule"] for entry in rules if "rule" in entry):
        parts = rule.get("expr", [])
        if any("accept" in part for part in parts):
            for part in parts:
                places |= _named(part.get("match", {}).get("right"))
    return places


def _is_accepted(port: str, address: str, places: set[str]) -> bool:
    if port in places:
        return True
    for place in places:
        with contextlib.suppress(ValueError):
            wanted, known = ipaddress.ip_network(address), ipaddress.ip_network(place, strict=False)
            if wanted.version == known.version and wanted.overlaps(known):
                return True
    return False


def _input_chains(rules: Rules) -> list[dict[str, Any]]:
    chains = (entry["chain"] for entry in rules if "chain" in entry)
    return [chain for chain in chains if chain.get("hook") == "input"]


def _input_chain(rules: Rules) -> str:
    """Return the chain for a new rule, in the form that `nft` expects."""
    chains = _input_chains(rules)
    shut = next((chain for chain in chains if chain.get("policy") == "drop"), chains[0])
    return f"{shut.get('family')} {shut.get('table')} {shut.get('name')}"


def _place(entry: dict[str, Any], chain: object) -> tuple[str, str, str]:
    return str(entry.get("family")), str(entry.get("table")), str(chain)


def _only_notes(part: dict[str, Any]) -> bool:
    return bool(part.keys() & {"counter", "log"})


def _named(value: Any) -> set[str]:
    if isinstance(value, dict) and isinstance(value.get("prefix"), dict):
        return {f"{value['prefix'].get('addr')}/{value['prefix'].get('len')}"}
    if isinstance(value, dict):
        return _named(value.get("set"))
    if isinstance(value, list):
        return {place for member in value for place in _named(member)}
    return {str(value)}


def _nft_rules() -> Rules | None:
    with contextlib.suppress(ValueError):
        value = json.loads(run("nft", "--json", "list", "ruleset") or "")
        if isinstance(value, dict) and isinstance(value.get("nftables"), list):
            return [entry for entry in value["nftables"] if isinstance(entry, dict)]
    return None


def _old_firewall() -> Check:
    """Check, without nft, the default policy of the older iptables."""
    tables = read("/proc/net/ip_tables_names")
    if tables is not None and "filter" not in tables.split():
        return skip("firewall", "nft is not here; no filter by the older iptables")
    policy = run("iptables", "-S", "INPUT")
    if policy is None:
        return skip("firewall", "cannot be read: as root, with nft: nft list ruleset")
    if "-P INPUT DROP" in policy:
        return warn(
            "firewall",
            "iptables drops what no rule names",
            "a camera may not be found, or send no image that arrives",
            "iptables -I INPUT -i PORT -p udp -j ACCEPT   (PORT: where the cameras are)",
        )
    return ok("firewall", "iptables drops nothing by default")
