"""The server on its own thread and event loop, so that clients do not load the cell's event loop.

Pictures come in through `post`; commands go out through `CommandWriter`, whose calls run on the cell's loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import asyncua
from asyncua import ua
from asyncua.crypto import security_policies
from asyncua.server.address_space import AttributeValue
from cryptography.hazmat.primitives.serialization import Encoding

from edged import __version__
from edged.adapters.opcua.connection import CHANNELS_PER_S, OpcUaConnection
from edged.adapters.opcua.methods import CommandWriter, Methods
from edged.adapters.opcua.model import read_model
from edged.adapters.opcua.nodes import CELL_URI, VISION_URI, base
from edged.adapters.opcua.picture import RegisterPicture
from edged.adapters.opcua.security import ServerIdentity, TrustList, Users
from edged.adapters.opcua.session import MAX_NODES, Server
from edged.adapters.opcua.settings import OpcUaSettings
from edged.adapters.opcua.space import Space
from edged.connections import Rate, TcpClient, TcpListener, contains
from edged.errors import EdgedError, ListenError, TookTooLong
from edged.logs import LogLimit

START_S, STOP_S = 30.0, 3.0
IDLE_S = 60.0
PRODUCT_URI = "urn:edged"
TRANSPORT_URI = "http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary"
POLICIES = (
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
)
LIMITS = (
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead,
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerBrowse,
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerTranslateBrowsePathsToNodeIds,
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxMonitoredItemsPerCall,
)

# its lines about malformed frames are under clients' control; the lines that matter are ours
logging.getLogger("asyncua").setLevel(logging.CRITICAL)
log = logging.getLogger(__name__)


class ServerThread:
    """Owns the server's thread. on_expired : called on it when a result has expired.

    gone : called on it with the id of each ended session.
    """

    def __init__(
        self,
        settings: OpcUaSettings,
        identity: ServerIdentity,
        handshake: CommandWriter,
        on_expired: Callable[[], None],
        gone: Callable[[ua.NodeId], None],
    ) -> None:
        self._settings = settings
        self._identity = identity
        self._handshake = handshake
        self._on_expired = on_expired
        self._gone = gone
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopping = asyncio.Event()
        self._thread: threading.Thread | None = None
        self._listener: TcpListener | None = None
        self._log = LogLimit(__name__)
        self._channels = Rate(CHANNELS_PER_S)
        self._connections: dict[TcpClient, OpcUaConnection] = {}
        self._newest: RegisterPicture | None = None
        self._shown = asyncio.Event()
        self._space: Space | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._falling: asyncio.Task[None] | None = None
        self._is_given_up = False

    @property
    def port(self) -> int:
        """Listening TCP port; 0 when closed."""
        return self._listener.port if self._listener is not None else 0

    async def start(self) -> None:
        """Build the address space and listen. Raises `ListenError`."""
        ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        loop = asyncio.get_running_loop()

        def tell(error: BaseException | None) -> None:
            if not ready.done():
                ready.set_result(None) if error is None else ready.set_exception(error)

        def done(error: BaseException | None) -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(tell, error)

        self._thread = threading.Thread(target=self._main, args=(done,), name="opcua", daemon=True)
        self._thread.start()
        try:
            async with asyncio.timeout(START_S):
                await ready
        except TimeoutError as error:
            place = f"{self._settings.host}:{self._settings.port}"
            raise TookTooLong(f"opcua on {place}: it has not started within {START_S:g} s") from error

    def post(self, picture: RegisterPicture) -> None:
        """Show a picture soon; a newer one replaces it."""
        self._newest = picture
        loop = self._loop
        if loop is not None:
            with contextlib.suppress(RuntimeError):  # it has just closed
                loop.call_soon_threadsafe(self._shown.set)

    async def stop(self) -> None:
        """Disconnect every client and end the thread."""
        self._is_given_up = True
        loop, thread = self._loop, self._thread
        if loop is not None:
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(self._stopping.set)
        if thread is not None:
            await asyncio.get_running_loop().run_in_executor(None, thread.join, STOP_S)
            if thread.is_alive():
                log.warning("opcua: the server did not end within %g s", STOP_S)

    # --- on the thread -------------------------------------------------------------------------

    def _main(self, done: Callable[[BaseException | None], None]) -> None:
        try:
            asyncio.run(self._run(done))
        except EdgedError as error:
            done(error)
        except Exception as error:
            log.exception("opcua: the server ended because of a bug")
            done(ListenError(f"opcua: {type(error).__name__}: {error}"))

    async def _run(self, done: Callable[[BaseException | None], None]) -> None:
        self._loop = asyncio.get_running_loop()
        settings = self._settings
        trust = TrustList(settings.trusted)
        users = Users(settings)
        server = Server(users, settings.max_clients, self._gone, anonymous=settings.anonymous)
        server.disabled_clock = True  # stopping it takes up to a second
        await self._prepare(server)
        self._space = space = Space(server, settings, read_model(), time.monotonic)
        space.build()
        Methods(server, space, self._handshake).install()
        policies = self._policies(server)
        server.refresh = self._before_read
        if self._is_given_up:
            return  # the start took too long and was given up
        self._listener = listener = TcpListener(
            "opcua",
            functools.partial(self._connect, server, policies, trust),
            self._admits,
            self._left,
            idle_s=IDLE_S,
        )
        await listener.open(settings.host, settings.port)
        await server.start()
        tasks = [asyncio.create_task(work) for work in (self._tick(server), self._show(space))]
        done(None)
        log.info(
            "opcua: serving opc.tcp://%s:%d, %d trusted certificates",
            settings.host,
            listener.port,
            len(trust),
        )
        stopped = asyncio.create_task(self._stopping.wait())
        try:
            await asyncio.wait({stopped, *tasks}, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                if task.done():
                    task.result()  # only a bug ends a task: raise it in the thread
        finally:
            await self._close(server, listener, [stopped, *tasks])

    async def _close(self, server: Server, listener: TcpListener, tasks: list[asyncio.Task[Any]]) -> None:
        if self._timer is not None:
            self._timer.cancel()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        connections = list(self._connections.values())
        await listener.close()
        for connection in connections:
            await connection.ended()
        for session in list(server.sessions.values()):
            await session.close_session(True)
        await server.stop()

    async def _prepare(self, server: Server) -> None:
        """Fill in the standard nodes of the server."""
        high = asyncua.Server(iserver=server)
        await high.init()
        await high.set_application_uri(self._settings.application_uri)
        await high.set_build_info(PRODUCT_URI, "edged", "edged", __version__, "", datetime.now(UTC))
        namespaces = server.aspace[base(ua.ObjectIds.Server_NamespaceArray)].attributes[ua.AttributeIds.Value]
        uris = ["http://opcfoundation.org/UA/", self._settings.application_uri, VISION_URI, CELL_URI]
        namespaces.value = ua.DataValue(ua.Variant(uris, ua.VariantType.String))
        for number in LIMITS:
            limit = ua.DataValue(ua.Variant(MAX_NODES, ua.VariantType.UInt32))
            server.aspace[base(number)].attributes[ua.AttributeIds.Value] = AttributeValue(limit)

    def _policies(self, server: Server) -> list[Any]:
        identity, policies = self._identity, []
        server.certificate, server.private_key = identity.certificate, identity.key
        wanted = list(POLICIES) if identity.certificate is not None else []
        if self._settings.anonymous:
            wanted.append(ua.SecurityPolicyType.NoSecurity)
        for kind in wanted:
            policy, mode, level = security_policies.SECURITY_POLICY_TYPE_MAP[kind]
            policies.append(
                security_policies.SecurityPolicyFactory(policy, mode, identity.certificate, identity.key)
            )
            server.add_endpoint(self._endpoint(policy.URI, mode, level))
        return policies

    def _endpoint(self, uri: str, mode: ua.MessageSecurityMode, level: int) -> ua.EndpointDescription:
        settings, certificate = self._settings, self._identity.certificate
        application = ua.ApplicationDescription()
        application.ApplicationName = ua.LocalizedText(f"edged {settings.cell}")
        application.ApplicationUri, application.ProductUri = settings.application_uri, PRODUCT_URI
        application.ApplicationType = ua.ApplicationType.Server
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        application.DiscoveryUrls.append(f"opc.tcp://{host}:{settings.port}")
        found = ua.EndpointDescription()
        found.EndpointUrl, found.Server = application.DiscoveryUrls[0], application
        found.SecurityMode, found.SecurityPolicyUri, found.SecurityLevel = mode, uri, level
        found.TransportProfileUri = TRANSPORT_URI
        if certificate is not None:
            found.ServerCertificate = certificate.public_bytes(Encoding.DER)
        tokens = []
        if mode is not ua.MessageSecurityMode.None_ and settings.password_hash:
            tokens.append(("username", ua.UserTokenType.UserName))
        if settings.anonymous:
            tokens.append(("anonymous", ua.UserTokenType.Anonymous))
        for name, kind in tokens:
            token = ua.UserTokenPolicy()
            # the channel is encrypted: the password need not be encrypted again
            token.PolicyId, token.TokenType = name, kind
            token.SecurityPolicyUri = security_policies.SecurityPolicyNone.URI
            found.UserIdentityTokens.append(token)
        return found

    # --- clients --------------------------------------------------------------------------------

    def _connect(
        self, server: Server, policies: list[Any], trust: TrustList, client: TcpClient
    ) -> OpcUaConnection:
        connection = OpcUaConnection(server, policies, trust, self._channels, client, self._log)
        # a client that was aborted while connecting has left already, and would stay in the dict
        if self._listener is not None and self._listener.client(client.name) is client:
            self._connections[client] = connection
        return connection

    def _admits(self, newcomer: TcpClient) -> bool:
        """Whether a new client may stay; no address gets more than half of the connections."""
        settings, peer = self._settings, newcomer.peer
        if settings.readers and not contains(settings.readers, peer):
            self._log.warning("opcua: %s is not in the list of networks, closed", peer)
            return False
        clients = self._listener.clients if self._listener is not None else ()
        same = [client for client in clients if client.peer == peer]
        if len(clients) < settings.max_clients and len(same) < max(settings.max_clients // 2, 1):
            return True
        strangers = [client for client in same if not self._is_active(client)]
        if not strangers:
            self._log.warning("opcua: %s closed, %d clients are connected", peer, len(clients))
            return False
        min(strangers, key=lambda client: client.active_s).abort()
        return True

    def _is_active(self, client: TcpClient) -> bool:
        connection = self._connections.get(client)
        return connection is not None and connection.is_active

    def _left(self, client: TcpClient) -> None:
        self._connections.pop(client, None)

    # --- showing -------------------------------------------------------------------------------

    async def _show(self, space: Space) -> None:
        while True:
            await self._shown.wait()
            self._shown.clear()
            picture = self._newest
            if picture is not None:
                await space.show(picture)
                self._watch(space, picture.valid_until_s)

    def _watch(self, space: Space, until_s: float) -> None:
        """Set the timer for the expiry of the result on display."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if until_s:
            loop = asyncio.get_running_loop()
            delay_s = max(until_s - time.monotonic(), 0.0)
            self._timer = loop.call_later(delay_s, lambda: self._keep(loop.create_task(self._expire(space))))

    def _keep(self, task: asyncio.Task[None]) -> None:
        self._falling = task  # without a reference the task may be collected before its end

    async def _expire(self, space: Space) -> None:
        if space.is_overdue:
            await space.expire()
            self._on_expired()

    async def _before_read(self) -> None:
        """Hide an expired result if a read comes before the timer."""
        if self._space is not None and self._space.is_overdue:
            await self._space.expire()

    async def _tick(self, server: Server) -> None:
        """Update the server's clock, which clients use as a heartbeat."""
        node, status = (
            server.aspace[base(number)].attributes[ua.AttributeIds.Value]
            for number in (ua.ObjectIds.Server_ServerStatus_CurrentTime, ua.ObjectIds.Server_ServerStatus)
        )
        while True:
            now = datetime.now(UTC)
            if status.value is not None and status.value.Value is not None:
                status.value.Value.Value.CurrentTime = now
            node.value = ua.DataValue(ua.Variant(now, ua.VariantType.DateTime), SourceTimestamp=now)
            for handle, tell in list(node.datachange_callbacks.items()):
                await tell(handle, node.value)
            await asyncio.sleep(1.0)
