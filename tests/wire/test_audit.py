"""Audit records of actions on the page, and who may read them."""

from __future__ import annotations

import asyncio
import logging

import pytest
from helpers.browsersession import PASSWORD
from helpers.waiting import until
from helpers.webcell import running

from edged.adapters.web.auditing import PERSON_BURST, REFUSED_BURST, RUN, Auditor
from edged.domain.cell import CellPhase
from edged.domain.events import Idle
from edged.identity.audit import AuditFile


@pytest.mark.slow
async def test_what_is_done_is_noted_with_who_and_its_outcome(caplog: pytest.LogCaptureFixture) -> None:
    """Actions and refusals are recorded with user and outcome, hashes of what changed, and logged alike."""
    caplog.set_level(logging.INFO, "edged.adapters.web.auditing")
    async with running() as cell:
        assert not await cell.comes_in("Anna", "guess")
        await cell.log_in("Otto")
        await cell.ask("POST", "/api/v1/setup", {})
        await cell.log_in()
        _, entered = await cell.ask("POST", "/api/v1/setup", {})
        await cell.ask("PUT", "/api/v1/setup/lease", entered)
        await cell.ask("POST", "/api/v1/users", {"name": "Erna", "role": "viewer", "password": PASSWORD})
        await cell.ask("PUT", "/api/v1/users/Erna", {"role": "operator"})
        await cell.ask("DELETE", "/api/v1/users/Erna", None)
        await cell.ask("DELETE", "/api/v1/users/Erna", None)
        await cell.ask("DELETE", "/api/v1/setup", entered)

        status, told = await cell.ask("GET", "/api/v1/audit", None)
        assert (200, None, 0) == (status, told["problem"], told["torn_bytes"])
        records = told["records"]
        assert [
            ("Anna", "log in", "page", "password"),
            ("Otto", "log in", "page", "ok"),
            ("Otto", "POST", "setup", "role"),
            ("Anna", "log in", "page", "ok"),
            ("Anna", "POST", "setup", "ok"),
            ("Anna", "POST", "users/Erna", "ok"),
            ("Anna", "PUT", "users/Erna", "ok"),
            ("Anna", "DELETE", "users/Erna", "ok"),
            ("Anna", "DELETE", "users/Erna", "no_user"),
            ("Anna", "DELETE", "setup", "ok"),
        ] == [(one["user"], one["verb"], one["object"], one["outcome"]) for one in records]
        made, changed, removed = records[5:8]
        assert made["before"] is None
        assert made["after"] == changed["before"]
        assert changed["after"] == removed["before"]
        assert changed["before"] != changed["after"]
        assert {"127.0.0.1"} == {one["address"] for one in records}
        assert [one["hash"] for one in records] == [
            record.edged["audit_hash"] for record in caplog.records if hasattr(record, "edged")
        ]
        _, some = await cell.ask("GET", "/api/v1/audit?after=3&most=2", None)
        assert ([4, 5], 10) == ([one["number"] for one in some["records"]], some["count"])
        assert PASSWORD not in str(told)


async def test_setup_that_the_plant_ends_is_noted() -> None:
    """SETUP ended by the plant is recorded, and SETUP ended by a person is recorded once as theirs."""
    async with running(visitor="Anna") as cell:
        for ends in (lambda: cell.cycle.lock_setup(True), None):
            _, entered = await cell.ask("POST", "/api/v1/setup", {})
            if ends is None:
                await cell.ask("DELETE", "/api/v1/setup", entered)
            else:
                ends()
            await until(lambda: cell.ear.state() is CellPhase.READY)
            cell.cycle.lock_setup(False)
        _, told = await cell.ask("GET", "/api/v1/audit", None)
        deeds = [(one["user"], one["verb"], one["object"]) for one in told["records"]]
        anna = [("Anna", "POST", "setup"), ("Anna", "DELETE", "setup")]
        assert [("Anna", "log in", "page"), anna[0], ("", "end", "setup"), *anna] == deeds


async def test_what_the_cell_runs_by_is_noted_however_it_was_changed() -> None:
    """Each change of the running configuration is recorded once with the previous one, however made."""
    async with running() as cell:

        async def noted() -> list[tuple[str | None, str]]:
            _, told = await cell.ask("GET", "/api/v1/audit", None)
            assert told["problem"] is None
            return [(one["before"], one["after"]) for one in told["records"] if one["verb"] == RUN]

        await cell.log_in()
        for fingerprint in ("0000000a", "0000000a", "0000000b"):
            cell.runs_by = fingerprint
            cell.web.announce(Idle())
        for _ in range(100):
            if len(await noted()) == 2:
                break
            await asyncio.sleep(0.02)
        after = Auditor(AuditFile(cell.state))
        for fingerprint in ("0000000b", "0000000c"):
            after.note_run(fingerprint)
        await after.close()
        runs = await noted()
        assert [(None, "0000000a"), ("0000000a", "0000000b"), ("0000000b", "0000000c")] == runs


async def test_who_only_may_look_does_not_fill_the_disc() -> None:
    """Repeated refusals stop being recorded after a burst, while successful actions are still recorded."""
    async with running(visitor="Vera") as cell:
        for _ in range(2 * int(REFUSED_BURST)):
            assert 403 == (await cell.ask("POST", "/api/v1/setup", {}))[0]
        await cell.log_in()
        _, told = await cell.ask("GET", "/api/v1/audit", None)
        assert REFUSED_BURST <= told["count"] <= REFUSED_BURST + 5
        assert ("log in", "ok") == (told["records"][-1]["verb"], told["records"][-1]["outcome"])


async def test_log_ins_have_a_quota_of_their_own() -> None:
    """Excess log-ins are not recorded but counted in a later record, and refusals are kept."""
    async with running() as cell:
        more = 7
        for _ in range(int(PERSON_BURST) + more):
            await cell.log_in("Vera")
        assert 403 == (await cell.ask("POST", "/api/v1/setup", {}))[0]
        await cell.log_in()
        _, told = await cell.ask("GET", "/api/v1/audit?most=500", None)
        records = [(one["user"], one["verb"], one["outcome"]) for one in told["records"]]
        assert PERSON_BURST == records.count(("Vera", "log in", "ok"))
        assert [("", "leave out", "rate"), ("Vera", "POST", "role"), ("Anna", "log in", "ok")] == records[-3:]
        assert told["records"][-3]["reason"].startswith(f"{more} refusals and log-ins before this")


async def test_what_was_lost_is_said_when_the_disc_takes_records_again() -> None:
    """The first record after a disk failure states how many records may be missing, and why."""
    async with running() as cell:
        (cell.state / "audit.jsonl").mkdir()
        for name in ("Vera", "Otto", "Anna"):
            await cell.log_in(name)
        (cell.state / "audit.jsonl").rmdir()
        await cell.ask("POST", "/api/v1/setup", {})
        _, told = await cell.ask("GET", "/api/v1/audit", None)
        lost, done = told["records"]
        assert ("lose", "disc", "POST") == (lost["verb"], lost["outcome"], done["verb"])
        assert lost["reason"].startswith("3 records before this may be missing: ")


async def test_an_audit_that_cannot_be_kept_is_in_the_journal(caplog: pytest.LogCaptureFixture) -> None:
    """If the audit file cannot be written, actions succeed and are logged with the reason."""
    caplog.set_level(logging.INFO, "edged.adapters.web.auditing")
    async with running() as cell:
        (cell.state / "audit.jsonl").mkdir()
        await cell.log_in()
        assert 201 == (await cell.ask("POST", "/api/v1/setup", {}))[0]
        said = [record.getMessage() for record in caplog.records]
        assert any("cannot be written" in line for line in said)
        assert any("POST 'setup' by Anna" in line for line in said)
