"""Users of the page: a file with names, roles and password hashes.

{"format": "edged users", "version": 1,
 "users": [{"name": "Anna", "role": "engineer", "password_hash": "$argon2id$…", "language": "de"}]}
"""

from __future__ import annotations

import threading
import unicodedata
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from edged.config.fields import check_password_hash
from edged.errors import FileFormatError
from edged.files.atomic import make_folders, read_bytes, write_atomically

MAX_USERS = 64
MAX_BYTES = 64 * 1024
LATIN = {
    **str.maketrans("АВЕЅІЈКМНОРСТХУҮԌԚԜ", "ABESIJKMHOPCTXYYGQW"),  # Cyrillic
    **str.maketrans("аесԁһіјӏоргԛѕѵхуүԝԍ", "aecdhijloprqsvxyywg"),
    **str.maketrans("ΑΒΕΖΗΙΚΜΝΟΡΤΥΧϹϺ", "ABEZHIKMNOPTYXCM"),  # Greek
    **str.maketrans("αγινορτυχϲϳ", "ayivoptuxcj"),
    **str.maketrans("ՍՏՕցհոսօզյ", "USOghnuoqj"),  # Armenian
    **str.maketrans("ıɩɑɡʏʀɪɴʜᴀᴄᴇᴊᴋᴍᴏᴘᴛᴜᴠᴡᴢ", "iiagyrinhacejkmoptuvwz"),  # Latin without a decomposition
}
"""Letters mapped to the Latin ones that they look like: from confusables.txt of Unicode's Technical Standard
39, those of the scripts that are found beside Latin on keyboards."""
ALIKE = str.maketrans(
    {
        **dict.fromkeys("I1|ǀ∣", "l"),
        **dict.fromkeys("0O", "o"),
        **dict.fromkeys("‐‑‒–—―−", "-"),
        **dict.fromkeys("’‘ʼ`´", "'"),
        **dict.fromkeys("\u034f\u115f\u1160\u17b4\u17b5\u3164\uffa0", ""),  # printable, but invisible
        **dict.fromkeys(map(chr, range(0xFE00, 0xFE10)), ""),
    }
)
"""Latin letters, digits and signs that most typefaces draw alike."""

RoleName = Literal["viewer", "operator", "engineer"]


def _printable(name: str) -> str:
    if not name.isprintable() or name != name.strip():
        raise ValueError("expected printable characters, on one line")
    return name


UserName = Annotated[str, StringConstraints(min_length=1, max_length=64), AfterValidator(_printable)]
Language = Annotated[str, StringConstraints(pattern=r"^[A-Za-z]{2,3}(-[A-Za-z0-9]{2,8}){0,2}$")]
"""A language tag of BCP 47."""


class User(BaseModel):
    """User with a role and a password. language : None: that of the browser."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    name: UserName
    role: RoleName
    password_hash: Annotated[str, StringConstraints(max_length=512), AfterValidator(check_password_hash)]
    language: Language | None = None


class _File(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")

    format: Literal["edged users"] = "edged users"
    version: Literal[1] = 1
    users: list[User] = Field(max_length=MAX_USERS)


class LastEngineer(Exception):
    """A change would leave no engineer."""


class NameTaken(Exception):
    """A new user's name looks like another user's."""


class UserFile:
    """The users of a cell, in a file. Names are compared by `key_of`: as people do, ignoring case.

    If the file cannot be used there are no users: `problem` says what is wrong, and it is not overwritten.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._users: dict[str, User] = {}
        self.problem = ""
        try:
            self._users = _read(path)
        except FileFormatError as error:
            self.problem = str(error)

    @property
    def users(self) -> list[User]:
        """All users, sorted by name."""
        return sorted(self._users.values(), key=lambda user: user.name.casefold())

    @property
    def has_engineer(self) -> bool:
        """Whether there is an engineer."""
        return any(user.role == "engineer" for user in self._users.values())

    def get(self, name: str) -> User | None:
        """User with this name; None if there is none."""
        return self._users.get(key_of(name))

    def like(self, name: str) -> User | None:
        """Another user whose name looks like this one; None also if a user has this name."""
        if self.get(name) is not None:
            return None
        return next((user for user in self._users.values() if look_alike(user.name, name)), None)

    def put(self, user: User) -> None:
        """Add or change a user. Raises `LastEngineer`, `NameTaken`, `FileFormatError`, `OSError`."""
        with self._lock:
            if (other := self.like(user.name)) is not None:
                raise NameTaken(f"{user.name} looks like {other.name}, who is somebody else")
            self._keep({**self._users, key_of(user.name): user})

    def remove(self, name: str) -> None:
        """Remove a user. Raises as `put`."""
        with self._lock:
            self._keep({key: user for key, user in self._users.items() if key != key_of(name)})

    def _keep(self, users: dict[str, User]) -> None:
        if self.problem:
            raise FileFormatError(self.problem)
        if len(users) > MAX_USERS:
            raise FileFormatError(f"{self._path}: more than {MAX_USERS} users")
        if self.has_engineer and all(user.role != "engineer" for user in users.values()):
            raise LastEngineer
        text = _File(users=list(users.values())).model_dump_json(indent=1)
        make_folders(self._path.parent)
        write_atomically(self._path, text.encode(), mode=0o600, is_state=True)
        self._users = users


def _read(path: Path) -> dict[str, User]:
    """Read the users by key; empty if there is no file. Raises `FileFormatError`."""
    if not path.exists():
        return {}
    data = read_bytes(path, "users")
    if len(data) > MAX_BYTES:
        raise FileFormatError(f"{path}: {len(data)} bytes are too many for users")
    try:
        found = _File.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))
        message = first["msg"].removeprefix("Value error, ")
        raise FileFormatError(f"{path}: {place}: {message}" if place else f"{path}: {message}") from error
    users = {key_of(user.name): user for user in found.users}
    if len(users) < len(found.users):
        raise FileFormatError(f"{path}: a name occurs twice")
    return users


def key_of(name: str) -> str:
    """Key by which names are compared: without case, width and other compatibility differences (NFKC)."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())


def look_alike(name: str, other: str) -> bool:
    """Whether the names can be mistaken for each other, as they are or in lower case."""
    return _skeleton(name) == _skeleton(other) or _skeleton(key_of(name)) == _skeleton(key_of(other))


def _skeleton(name: str) -> str:
    """Visual skeleton of a name (UTS 39, section 4), in Latin letters."""
    letters = unicodedata.normalize("NFD", unicodedata.normalize("NFKC", name))
    return " ".join(letters.translate(LATIN).translate(ALIKE).split())
