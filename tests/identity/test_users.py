"""The file of users, and the code with which the first engineer logs in."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from argon2 import PasswordHasher
from helpers.webcell import HASH

from edged.config.reading import load
from edged.errors import ConfigError, FileFormatError
from edged.files.statefolder import page_folder, state_folder
from edged.identity.invite import VALID_S, Invite
from edged.identity.users import MAX_USERS, LastEngineer, NameTaken, User, UserFile

CELL = "[cell]\nname = 'c'\nrig = 'rig.json'\njobs = 'jobs'\njob = 'a'\n[cameras]\nsource = 'virtual'\n"
ANNA = User(name="Anna", role="engineer", password_hash=HASH, language="de")


def test_users_are_there_again_after_a_restart(tmp_path: Path) -> None:
    """Users are read back with role and language, from a file for its owner alone, and names ignore case."""
    path = tmp_path / "state" / "users.json"
    users = UserFile(path)
    users.put(ANNA)
    users.put(User(name="Otto", role="operator", password_hash=HASH))
    users.put(User(name="OTTO", role="viewer", password_hash=HASH))

    again = UserFile(path)
    assert ["Anna", "OTTO"] == [user.name for user in again.users]
    assert ANNA == again.get("aNNa")
    assert 0o600 == path.stat().st_mode & 0o777
    again.remove("otto")
    assert ["Anna"] == [user.name for user in UserFile(path).users]


def test_the_last_engineer_stays_one(tmp_path: Path) -> None:
    """The last engineer cannot be removed or given another role, and nothing is written."""
    users = UserFile(tmp_path / "users.json")
    users.put(ANNA)
    for change in (
        lambda: users.remove("Anna"),
        lambda: users.put(ANNA.model_copy(update={"role": "viewer"})),
    ):
        with pytest.raises(LastEngineer):
            change()
    assert [ANNA] == UserFile(tmp_path / "users.json").users


def entry(**changes: Any) -> dict[str, Any]:
    """One user of the file."""
    return {"name": "Anna", "role": "engineer", "password_hash": HASH, **changes}


def listing(*users: Any, **changes: Any) -> bytes:
    """The contents of a file of users."""
    return json.dumps({"format": "edged users", "version": 1, "users": list(users), **changes}).encode()


@pytest.mark.parametrize(
    "data, place",
    [
        (b"", "JSON"),
        (b"\xff\xfe", "JSON"),
        (b"[" * 50_000, "JSON"),
        (b"{}", "users"),
        (listing(version=2), "version"),
        (listing(colour=1), "colour"),
        (listing(entry(role="root")), "users.0.role"),
        (listing(entry(role=2)), "users.0.role"),
        (listing(entry(name="")), "users.0.name"),
        (listing(entry(name="a\nb")), "users.0.name"),
        (listing(entry(name=" Anna")), "users.0.name"),
        (listing(entry(password_hash="secret")), "users.0.password_hash"),
        (listing(entry(language="../de")), "users.0.language"),
        (listing(entry(), entry(name="ANNA")), "twice"),
        (listing(*(entry(name=f"user {n}") for n in range(MAX_USERS + 1))), "users"),
        (listing(entry()) + b" " * 70_000, "too many"),
    ],
)
def test_a_file_that_cannot_be_used_is_nobodys(data: bytes, place: str, tmp_path: Path) -> None:
    """An unusable file is named with the place, has no users, and is not overwritten."""
    path = tmp_path / "users.json"
    path.write_bytes(data)
    users = UserFile(path)
    assert str(path) in users.problem
    assert place in users.problem
    assert [] == users.users
    with pytest.raises(FileFormatError):
        users.put(ANNA)
    assert data == path.read_bytes()


CHEAP = PasswordHasher(time_cost=1, memory_cost=512, parallelism=1).hash("x")
HEAD, SALT, DIGEST = CHEAP.rsplit("$", 2)


@pytest.mark.parametrize(
    "dear",
    [
        CHEAP.replace("m=512", "m=1048576"),
        CHEAP.replace("t=1", "t=100"),
        CHEAP.replace("p=1", "p=64"),
        CHEAP.replace("m=512", "m=5_12"),
        CHEAP.replace("m=512", "m=\u0665\u0661\u0662"),
        f"{HEAD}${SALT * 10}${DIGEST}",
        f"{HEAD}${SALT}${DIGEST * 4}",
        f"{HEAD}${SALT}${DIGEST[:6]}",
        f"{HEAD}$${DIGEST}",
    ],
    ids=["memory", "passes", "lanes", "underscore", "other digits", "salt", "hash", "short hash", "no salt"],
)
def test_a_hash_that_costs_or_proves_something_else_is_refused(dear: str, tmp_path: Path) -> None:
    """A hash with other costs or a short one is refused without computing it."""
    assert dear != CHEAP
    (tmp_path / "users.json").write_bytes(listing(entry(password_hash=dear)))
    assert "users.0.password_hash" in UserFile(tmp_path / "users.json").problem
    (tmp_path / "cell.toml").write_text(f"{CELL}[web]\npassword_hash = '{dear}'\n")
    with pytest.raises(ConfigError) as refused:
        load(tmp_path / "cell.toml")
    assert "web.password_hash" in str(refused.value)
    assert dear not in str(refused.value)


def test_a_code_comes_in_once_and_for_a_day(tmp_path: Path) -> None:
    """A code works once and for a day, however it is typed; a new one replaces it, a wrong one does not
    end it."""
    now_s = [1000.0]
    invite = Invite(tmp_path / "state", lambda: now_s[0])

    def takes(code: str) -> bool:
        return invite.take(code, "Erna", is_new=True)

    first = invite.make()
    code = invite.make()
    assert first != code
    assert not takes(first)
    assert not takes("")
    assert code.replace("-", "") not in (tmp_path / "state" / "invite.json").read_text()
    now_s[0] += VALID_S - 1
    assert takes(f" {code.upper().replace('-', ' ')} ")
    assert not takes(code)
    code = invite.make()
    now_s[0] += VALID_S
    assert not takes(code)


def test_a_code_is_for_one_name(tmp_path: Path) -> None:
    """A code works for its name only, however that is written; one without a name works for a new name
    only."""
    invite = Invite(tmp_path)
    code = invite.make("Jörg")
    for name in ("Anna", "", "Jorg"):
        assert not invite.take(code, name, is_new=True)
    assert invite.take(code, "JO\u0308RG", is_new=False)
    code = invite.make()
    assert not invite.take(code, "Anna", is_new=False)
    assert invite.take(code, "Anna", is_new=True)


def test_a_name_is_the_same_however_it_is_typed(tmp_path: Path) -> None:
    """A name is the same in any Unicode form, width and case, and a new name must not look like another's."""
    users = UserFile(tmp_path / "users.json")
    users.put(User(name="Jörg", role="engineer", password_hash=HASH))
    users.put(User(name="Iris", role="operator", password_hash=HASH))
    for same in ("JÖRG", "jo\u0308rg", "\uff2a\u00f6\uff52\uff47"):
        assert users.get(same) is not None
    for alike in ("lris", "1ris", "\u0406ris", "Ir\u0456s", "Iris\u3164"):
        with pytest.raises(NameTaken):
            users.put(User(name=alike, role="viewer", password_hash=HASH))
    for other in ("Jorg", "Irina", "Ella", "Elia"):
        users.put(User(name=other, role="viewer", password_hash=HASH))
    assert 6 == len(UserFile(tmp_path / "users.json").users)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"digest": 1, "until_s": "x"}', '{"digest": null, "until_s": []}']
)
def test_a_damaged_invitation_lets_nobody_in(text: str, tmp_path: Path) -> None:
    """A damaged invitation lets nobody in and raises nothing."""
    (tmp_path / "invite.json").write_text(text)
    assert not Invite(tmp_path).take("abcd-efgh-jkmn", "Erna", is_new=True)


def test_the_state_of_a_cell_has_one_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The state folder is the service's, also from a shell, or beside a configuration that is not installed.

    The page has a folder of its own if it is a service of its own, and no cell's name gives that folder.
    """
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    assert tmp_path / ".cell.state" == state_folder(tmp_path / "cell.toml")
    assert tmp_path / ".cell.state" == page_folder(tmp_path / "cell.toml")
    monkeypatch.setattr("edged.files.statefolder.INSTALLED", tmp_path)
    assert Path("/var/lib/edged") == state_folder(tmp_path / "cell.toml")
    assert Path("/var/lib/edged-line3") == state_folder(tmp_path / "line3.toml")
    assert Path("/var/lib/edged_page") == page_folder(tmp_path / "cell.toml")
    assert Path("/var/lib/edged_page-line3") == page_folder(tmp_path / "line3.toml")
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/other:/var/lib/more")
    assert (
        Path("/var/lib/other") == state_folder(tmp_path / "cell.toml") == page_folder(tmp_path / "cell.toml")
    )
