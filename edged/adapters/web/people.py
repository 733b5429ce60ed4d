"""Users over /api/v1: one's own role, language, password and sessions, and user management by engineers."""

from __future__ import annotations

import asyncio
import hashlib
from typing import Annotated

from pydantic import Field, StringConstraints

from edged.adapters.web.routes import Answer, Body, Call, Problem, route
from edged.identity.access import Access
from edged.identity.passwords import MIN_LENGTH, why_weak
from edged.identity.users import Language, LastEngineer, NameTaken, RoleName, User, UserFile, UserName
from edged.identity.visitors import Role

Password = Annotated[str, StringConstraints(min_length=MIN_LENGTH, max_length=256, strip_whitespace=False)]
"""A new password."""
Said = Annotated[str, StringConstraints(max_length=256, strip_whitespace=False)]
"""A password as entered, to be checked."""
PERSON = "/users/{name:[^/]{1,64}}"


class Me(Answer):
    """The visitor. language : a tag of BCP 47; null: the browser's."""

    name: str = Field(description="empty: with the page's password alone")
    role: str
    language: str | None
    idle: bool = Field(description="the rights come back with the password")


class MyChange(Body):
    """Change that every user may make to their own entry."""

    language: Language | None


class MyPassword(Body):
    """Change of one's own password."""

    old: Said
    new: Password


class Waking(Body):
    """One's own password, entered again."""

    password: Said


class MySession(Answer):
    """A session of the visitor. age_s : since log-in. idle_s : since an action. this : the current one."""

    address: str
    age_s: int
    idle_s: int
    this: bool


class MySessions(Answer):
    """All open sessions of the visitor, oldest first."""

    sessions: list[MySession]


class NewUser(Body):
    """A user to add."""

    name: UserName
    role: RoleName
    password: Password
    language: Language | None = None


class UserChange(Body):
    """Change of a user; fields that are left out stay as they are."""

    role: RoleName | None = None
    password: Password | None = None
    language: Language | None = None


class UserNow(Answer):
    """A user as stored, without the password."""

    name: str
    role: str
    language: str | None


class UsersNow(Answer):
    """All users. problem : why the users' file cannot be used, if so."""

    users: list[UserNow]
    problem: str | None


class People:
    """The routes of users."""

    def __init__(self, access: Access, users: UserFile) -> None:
        self._access = access
        self._users = users

    @route("GET", "/me", "Who I am, and what I may", role=Role.VIEWER)
    async def _me(self, call: Call[None]) -> Me:
        visitor = call.visitor
        return Me(name=visitor.name, role=visitor.role.word, language=visitor.language, idle=visitor.is_idle)

    @route("PUT", "/me", "My language", role=Role.VIEWER)
    async def _change_me(self, call: Call[MyChange]) -> UserNow:
        user = self._user(call.visitor.name).model_copy(update={"language": call.body.language})
        await self._put(user)
        return _now(user)

    @route("PUT", "/me/password", "Another password", role=Role.VIEWER, audit=True)
    async def _my_password(self, call: Call[MyPassword]) -> None:
        user = self._user(call.visitor.name)
        _check_strength(call.body.new, user.name, "new")
        if not await self._access.is_user(call.visitor.address, user.name, call.body.old):
            raise Problem(403, "password", "old: this is not your password", field="old")
        password_hash = await self._access.hash(call.visitor.address, call.body.new)
        await self._put(self._user(user.name).model_copy(update={"password_hash": password_hash}))
        self._access.end_sessions(user.name, but=call.visitor.session)

    @route(
        "POST",
        "/me/wake",
        "The password again: after being idle, and before what needs it",
        role=Role.VIEWER,
        audit=True,
    )
    async def _wake(self, call: Call[Waking]) -> None:
        self._user(call.visitor.name)
        if not await self._access.confirm(call.visitor.address, call.visitor, call.body.password):
            raise Problem(403, "password", "password: this is not your password", field="password")

    @route("GET", "/me/sessions", "Where I am logged in", role=Role.VIEWER)
    async def _my_sessions(self, call: Call[None]) -> MySessions:
        user = self._user(call.visitor.name)
        return MySessions(
            sessions=[
                MySession(
                    address=session.address,
                    age_s=round(self._access.now_s() - session.since_s),
                    idle_s=round(self._access.now_s() - session.active_s),
                    this=digest == call.visitor.session,
                )
                for digest, session in self._access.sessions(user.name)
            ]
        )

    @route("DELETE", "/me/sessions", "Log me out everywhere, here too", role=Role.VIEWER, audit=True)
    async def _end_my_sessions(self, call: Call[None]) -> None:
        self._access.end_sessions(self._user(call.visitor.name).name)

    @route("GET", "/users", "Everybody with a password")
    async def _all(self, _call: Call[None]) -> UsersNow:
        return UsersNow(users=[_now(user) for user in self._users.users], problem=self._users.problem or None)

    @route("POST", "/users", "Somebody new", status=201, audit=True, needs_password=True)
    async def _add(self, call: Call[NewUser]) -> UserNow:
        body = call.body
        if self._users.get(body.name) is not None:
            raise Problem(409, "exists", f"there is a user {body.name} already", field="name")
        _check_strength(body.password, body.name, "password")
        password_hash = await self._access.hash(call.visitor.address, body.password)
        user = User(name=body.name, role=body.role, password_hash=password_hash, language=body.language)
        call.trail.object, call.trail.after = user.name, _digest(user)
        await self._put(user)
        return _now(user)

    @route("PUT", PERSON, "Another role, password or language", audit=True, needs_password=True)
    async def _change(self, call: Call[UserChange]) -> None:
        changes = call.body.model_dump(exclude_unset=True, exclude={"password"})
        if changes.get("role", "") is None:
            raise Problem(400, "invalid", "role: expected viewer, operator or engineer", field="role")
        name = self._user(call.part("name")).name
        if call.body.password is not None:
            _check_strength(call.body.password, name, "password")
            changes["password_hash"] = await self._access.hash(call.visitor.address, call.body.password)
        before = self._user(name)
        user = before.model_copy(update=changes)
        call.trail.before, call.trail.after = _digest(before), _digest(user)
        await self._put(user)
        if call.body.password is not None:
            own = name == call.visitor.name
            self._access.end_sessions(name, but=call.visitor.session if own else "")

    @route("DELETE", PERSON, "Take somebody out; their sessions end", audit=True, needs_password=True)
    async def _remove(self, call: Call[None]) -> None:
        user = self._user(call.part("name"))
        name, call.trail.before = user.name, _digest(user)
        try:
            await asyncio.to_thread(self._users.remove, name)
        except LastEngineer:
            raise _last_engineer(name) from None
        self._access.end_sessions(name)

    def _user(self, name: str) -> User:
        user = self._users.get(name) if name else None
        if user is None:
            what = f"there is no user {name}" if name else "the page's password belongs to nobody"
            raise Problem(404, "no_user", what)
        return user

    async def _put(self, user: User) -> None:
        try:
            await asyncio.to_thread(self._users.put, user)
        except LastEngineer:
            raise _last_engineer(user.name) from None
        except NameTaken as error:
            raise Problem(409, "exists", str(error), field="name") from None


def _check_strength(password: str, name: str, field: str) -> None:
    """Check that a password is not easily guessed. Raises `Problem`."""
    if why := why_weak(password, name):
        raise Problem(400, "weak_password", f"{field}: {why}", field=field)


def _last_engineer(name: str) -> Problem:
    return Problem(409, "last_engineer", f"{name} is the only engineer: make another one first")


def _digest(user: User) -> str:
    """Digest for the audit, which reveals neither role nor password."""
    return hashlib.sha256(user.model_dump_json().encode()).hexdigest()


def _now(user: User) -> UserNow:
    return UserNow(name=user.name, role=user.role, language=user.language)
