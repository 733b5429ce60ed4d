"""Forms that need no session (log in, log out, redeem an invitation), and the host names that are served."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import math
import re
import socket
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import parse_qs

from aiohttp import web
from cryptography import x509
from markupsafe import Markup
from pydantic import TypeAdapter, ValidationError

from edged.adapters.web.auditing import Auditor
from edged.adapters.web.people import Password
from edged.adapters.web.places import body_of
from edged.adapters.web.settings import WebSettings
from edged.adapters.web.texts import Texts, language_of
from edged.config.fields import is_loopback
from edged.errors import FileFormatError
from edged.identity.access import Access
from edged.identity.attempts import TooManyAttempts
from edged.identity.invite import Invite
from edged.identity.passwords import MIN_LENGTH, why_weak
from edged.identity.users import UserFile, UserName
from edged.identity.visitors import Visitor
from edged.report.page import render

log = logging.getLogger(__name__)

FORM_S = 5.0
"""Time limit for receiving a form."""
MAX_FORM_BYTES = 4096
NEXT = {"setup": "/setup"}
"""Pages that the log-in may lead to, by the `to` of its address; else the status page."""
REFUSED = {
    "wrong": "invite-wrong",
    "differ": "invite-differ",
    "short": "invite-short",
    "common": "invite-common",
}
"""Text that the invitation form shows, by the query of its address."""
COMMAND = Markup('<code translate="no">edged web invite</code>')
_NAME, _PASSWORD = TypeAdapter(UserName), TypeAdapter(Password)


def visitor_of(access: Access, request: web.Request) -> Visitor | None:
    """Visitor whose session sent a request, if any."""
    return access.visitor(request.cookies.get(access.cookie, ""), request.remote or "")


def cookie_name(cell: str, *, secure: bool) -> str:
    """Name of the session cookie of a cell.

    Browsers send a cookie to every port of a host, so each cell has a name of its own. secure : served over
    TLS; then no other host, and no page without TLS, can set it (`__Host-`, RFC 6265bis).
    """
    return f"{'__Host-' if secure else ''}edged_{hashlib.sha256(cell.encode()).hexdigest()[:12]}"


def is_from_here(request: web.Request) -> bool:
    """Whether a page of this very host sent the request (by its Origin)."""
    host = request.headers.get("Host")
    return host is not None and request.headers.get("Origin") == f"{request.scheme}://{host}"


class ServedNames:
    """Host names under which the page is served: the machine's own, the certificate's, and the settings'.

    By DNS rebinding, a foreign page could point its own name here, and read a cell without a password, or
    guess passwords from its visitors' browsers. Numeric addresses cannot be rebound: with a password all are
    served, since there may be an address translation in between.
    """

    def __init__(self, settings: WebSettings) -> None:
        own = socket.gethostname().lower()
        self._is_open = not settings.password_hash
        self._names = {settings.host.lower(), *map(str.lower, settings.names)}
        if not self._is_open:
            self._names |= {own, own.partition(".")[0], f"{own.partition('.')[0]}.local"}
            self._names |= set(_certified(settings.certificate))

    def has(self, host: str) -> bool:
        """Whether a Host header names this machine by a name that is served."""
        name = re.sub(r":[0-9]*$", "", host).strip("[]").lower().removesuffix(".")
        if is_loopback(name):
            return True
        try:
            ip_address(name)
        except ValueError:
            return name in self._names or f"*.{name.partition('.')[2]}" in self._names
        return not self._is_open or name in self._names


class LoginForms:
    """Handlers of the log-in, log-out and invitation forms.

    users : there are users, besides the page's password. secure : served over TLS.
    """

    def __init__(self, cell: str, access: Access, auditor: Auditor, *, users: bool, secure: bool) -> None:
        self._cell = cell
        self._access = access
        self._auditor = auditor
        self._secure = secure
        self._users = users
        self._texts = Texts("login")

    def add_to(self, router: web.UrlDispatcher) -> None:
        """Add the routes."""
        router.add_get("/login", self._login_form)
        router.add_post("/login", self._log_in)
        router.add_post("/logout", self._log_out)
        if self._users:
            router.add_get("/invite", self._invite_form)
            router.add_post("/invite", self._redeem)

    async def _login_form(self, request: web.Request) -> web.Response:
        wrong = "login-wrong" if self._users else "login-wrong-password"
        return self._page(request, "login.html", wrong if "wrong" in request.query else "")

    async def _invite_form(self, request: web.Request) -> web.Response:
        refused = next((text for code, text in REFUSED.items() if code in request.query), "")
        return self._page(request, "invite.html", refused)

    def _page(
        self, request: web.Request, form: str, problem: str = "", status: int = 200, **values: object
    ) -> web.Response:
        """A form in the visitor's language. problem : id of a text, filled in with `values`; "" : none."""
        language = language_of(request, self._texts.languages)
        say = self._texts.in_language(language)
        common = {"command": COMMAND, "least": MIN_LENGTH}
        text = render(
            form,
            __package__,
            language=language,
            t=say,
            cell=self._cell,
            problem=say(problem, **common, **values) if problem else "",
            users=self._users,
            one=not self._access.is_open,
            **common,
        )
        return web.Response(text=text, status=status, content_type="text/html", charset="utf-8")

    def _wait(self, request: web.Request, form: str, error: TooManyAttempts) -> web.Response:
        wait_s = math.ceil(error.wait_s)
        answer = self._page(request, form, "login-wait", 429, wait_s=wait_s)
        answer.headers["Retry-After"] = f"{wait_s}"
        return answer

    async def _log_in(self, request: web.Request) -> web.Response:
        _check_origin(request)
        form = await _fields(request)
        name, password = form.get("name", "").strip(), form.get("password", "")
        is_known = bool(password) and (self._users or not name)
        address = request.remote or ""
        try:
            cookie = await self._access.log_in(address, password, name) if is_known else None
        except TooManyAttempts as error:
            return self._wait(request, "login.html", error)
        to = request.query.get("to", "")
        if self._users:
            await self._auditor.note_login(request, name, "log in", "password" if cookie is None else "ok")
        if cookie is None:
            log.warning("status page: wrong password from %s", request.remote)
            raise web.HTTPSeeOther("/login?wrong" + (f"&to={to}" if to in NEXT else ""))
        raise self._entered(cookie, NEXT.get(to, "/"))

    async def _redeem(self, request: web.Request) -> web.Response:
        _check_origin(request)
        form = await _fields(request)
        try:
            name = _NAME.validate_python(form.get("name", "").strip())
            password = _PASSWORD.validate_python(form.get("password", ""))
        except ValidationError:
            raise web.HTTPSeeOther("/invite?short") from None
        if password != form.get("again"):
            raise web.HTTPSeeOther("/invite?differ")
        if why_weak(password, name):
            raise web.HTTPSeeOther("/invite?common")
        try:
            cookie = await self._access.redeem(request.remote or "", form.get("code", ""), name, password)
        except TooManyAttempts as error:
            return self._wait(request, "invite.html", error)
        except (FileFormatError, OSError) as error:
            log.error("%s cannot be made an engineer: %s", name, error)  # noqa: TRY400  (it says where)
            return self._page(request, "invite.html", "invite-storage", 500, detail=error)
        outcome = "code" if cookie is None else "ok"
        await self._auditor.note_login(request, name, "come in by a code", outcome)
        if cookie is None:
            log.warning("status page: wrong invitation from %s", request.remote)
            raise web.HTTPSeeOther("/invite?wrong")
        log.warning("status page: %s at %s is an engineer now, by invitation", name, request.remote)
        raise self._entered(cookie, "/setup")

    async def _log_out(self, request: web.Request) -> web.Response:
        _check_origin(request)
        self._access.log_out(request.cookies.get(self._access.cookie, ""))
        answer = web.HTTPSeeOther("/login")
        answer.del_cookie(
            self._access.cookie, path="/", secure=self._secure, httponly=True, samesite="Strict"
        )
        raise answer

    def _entered(self, cookie: str, to: str) -> web.HTTPSeeOther:
        answer = web.HTTPSeeOther(to)
        answer.set_cookie(
            self._access.cookie, cookie, httponly=True, samesite="Strict", secure=self._secure, path="/"
        )
        return answer


def log_user_status(users: UserFile, invite: Invite, place: str) -> None:
    """Log that the users' file cannot be used, or how the first engineer gets in."""
    if users.problem:
        log.error("nobody can log in by name: %s", users.problem)
    elif not users.has_engineer:
        try:
            code = invite.make()
        except OSError as error:
            log.error("the code for the first engineer cannot be saved: %s", error)  # noqa: TRY400  (says where)
            return
        log.warning(
            "nobody may set the cell up yet: %s/invite with the code %s, today, by a new name", place, code
        )


def _certified(certificate: Path | None) -> list[str]:
    """DNS names of a certificate; empty where it cannot be read, which `page_context` reports."""
    if certificate is None:
        return []
    try:
        found = x509.load_pem_x509_certificate(certificate.read_bytes())
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (OSError, ValueError, x509.ExtensionNotFound):
        return []
    return [name.lower() for name in names.get_values_for_type(x509.DNSName)]


def _check_origin(request: web.Request) -> None:
    """Check that no foreign page logs a visitor in or out. Raises `HTTPForbidden`."""
    if not is_from_here(request):
        raise web.HTTPForbidden(text="the request came from a page of another host, or from none\n")


async def _fields(request: web.Request) -> dict[str, str]:
    """Fields of a form, the first of each name. Raises `HTTPBadRequest`."""
    # not `request.post()`: it fails on input that no browser sends, such as other character sets
    try:
        async with asyncio.timeout(FORM_S):
            data = b""
            async for chunk in body_of(request):
                data += chunk
                if len(data) > MAX_FORM_BYTES:
                    raise web.HTTPRequestEntityTooLarge(MAX_FORM_BYTES, len(data))
            form = parse_qs(data.decode("ascii", "replace"))
    except (TimeoutError, ValueError, web.RequestPayloadError) as error:
        raise web.HTTPBadRequest(text="this is no form\n") from error
    return {name: values[0] for name, values in form.items()}
