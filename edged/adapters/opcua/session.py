"""asyncua's sessions and requests, with the checks that it lacks: ownership of subscriptions, and limits.

Responsible for: which services there are, who may use them, how much one session may hold. Not for the data
on the wire (`connection`) nor for the content of the nodes (`space`).
"""

from __future__ import annotations

import contextvars
import secrets
from collections.abc import Awaitable, Callable
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.uaprocessor import UaProcessor

from edged.adapters.opcua.security import Users

MAX_NODES = 1000
"""Most nodes in one request; the registers are half as many."""
MAX_SUBSCRIPTIONS, MAX_ITEMS = 4, 2000
"""Limits of one session."""
MIN_PUBLISHING_MS, MAX_PUBLISHING_MS = 10.0, 60_000.0
MAX_QUEUE, MAX_UNACKNOWLEDGED = 100, 16
SESSION_MS = 60_000.0

_S = ua.ObjectIds
DISCOVERY = frozenset(
    {
        _S.GetEndpointsRequest_Encoding_DefaultBinary,
        _S.FindServersRequest_Encoding_DefaultBinary,
        _S.CloseSecureChannelRequest_Encoding_DefaultBinary,
    }
)
"""Services allowed without a session and without encryption: discovery of endpoints."""
OPENING = frozenset(
    {
        _S.CreateSessionRequest_Encoding_DefaultBinary,
        _S.ActivateSessionRequest_Encoding_DefaultBinary,
        _S.CloseSessionRequest_Encoding_DefaultBinary,
    }
)
SERVICES = frozenset(
    {
        _S.ReadRequest_Encoding_DefaultBinary,
        _S.BrowseRequest_Encoding_DefaultBinary,
        _S.TranslateBrowsePathsToNodeIdsRequest_Encoding_DefaultBinary,
        _S.CallRequest_Encoding_DefaultBinary,
        _S.RegisterNodesRequest_Encoding_DefaultBinary,
        _S.UnregisterNodesRequest_Encoding_DefaultBinary,
        _S.CreateSubscriptionRequest_Encoding_DefaultBinary,
        _S.ModifySubscriptionRequest_Encoding_DefaultBinary,
        _S.DeleteSubscriptionsRequest_Encoding_DefaultBinary,
        _S.SetPublishingModeRequest_Encoding_DefaultBinary,
        _S.CreateMonitoredItemsRequest_Encoding_DefaultBinary,
        _S.ModifyMonitoredItemsRequest_Encoding_DefaultBinary,
        _S.DeleteMonitoredItemsRequest_Encoding_DefaultBinary,
        _S.SetMonitoringModeRequest_Encoding_DefaultBinary,
        _S.PublishRequest_Encoding_DefaultBinary,
        _S.RepublishRequest_Encoding_DefaultBinary,
    }
)
"""Services of an active session. Write is not among them: commands are methods."""

NOBODY = User(role=UserRole.Anonymous)

caller: contextvars.ContextVar[OpcUaSession | None] = contextvars.ContextVar("opcua_caller", default=None)
"""The session whose method call is running."""


async def _nothing() -> None:
    pass


class Server(InternalServer):
    """asyncua's server without its socket. max_sessions : at a time. gone : called for each ended session."""

    def __init__(
        self, users: Users, max_sessions: int, gone: Callable[[ua.NodeId], None], *, anonymous: bool
    ) -> None:
        super().__init__(user_manager=users)
        self.users = users
        self.anonymous = anonymous
        self.allow_remote_admin = False
        self.max_sessions = max_sessions
        self.gone = gone
        self.sessions: dict[ua.NodeId, OpcUaSession] = {}
        self.refresh: Callable[[], Awaitable[None]] = _nothing  # called before values are read
        self.max_session_timeout_ms = SESSION_MS
        self.max_unacked_messages_per_subscription = MAX_UNACKNOWLEDGED
        self.max_monitored_item_queue_size = MAX_QUEUE
        self.max_subscriptions = MAX_SUBSCRIPTIONS * max_sessions
        self.supported_tokens = (
            ua.UserNameIdentityToken,
            *((ua.AnonymousIdentityToken,) if anonymous else ()),
        )

    def create_session(
        self,
        name: Any,
        user: User = NOBODY,
        external: bool = False,
    ) -> OpcUaSession:
        """Create a session for a connection. Raises `ServiceError` when there are too many."""
        if len(self.sessions) >= self.max_sessions:
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        session = OpcUaSession(
            self, self.aspace, self.subscription_service, name, user=user, external=external
        )
        self.sessions[session.session_id] = session
        return session

    def lookup_external_session(self, auth_token: ua.NodeId) -> None:
        """Find no session: each ends with its connection, and cannot be transferred to another."""


class OpcUaSession(InternalSession):
    """A client's session: it can use only its own subscriptions, and only a share of the server."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.iserver.unregister_external_session(self)
        self.auth_token = ua.NodeId(secrets.token_bytes(32), 0)  # asyncua's counter could be guessed

    @property
    def may_command(self) -> bool:
        """Whether its user logged in with the password."""
        return self.user.name is not None

    async def close_session(self, delete_subs: bool = True) -> None:  # noqa: ARG002  # all of it, always
        """End the session and delete its subscriptions."""
        server = self.iserver
        if isinstance(server, Server) and server.sessions.pop(self.session_id, None) is not None:
            server.gone(self.session_id)
        await super().close_session(True)

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        """Read values of nodes, after hiding an expired result."""
        _limit(params.NodesToRead)
        if isinstance(self.iserver, Server):
            await self.iserver.refresh()
        return await super().read(params)

    async def browse(self, params: ua.BrowseParameters) -> list[ua.BrowseResult]:
        """Browse the references of nodes."""
        _limit(params.NodesToBrowse)
        return await super().browse(params)

    async def translate_browsepaths_to_nodeids(
        self, params: list[ua.BrowsePath]
    ) -> list[ua.BrowsePathResult]:
        """Find nodes by their browse paths."""
        _limit(params)
        return await super().translate_browsepaths_to_nodeids(params)

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Call a method, which finds this session in `caller`."""
        if len(params) > 1:  # one command per request: a second one would run before the first is answered
            raise ServiceError(ua.StatusCodes.BadTooManyOperations)
        caller.set(self)
        return await super().call(params)

    async def create_subscription(
        self, params: ua.CreateSubscriptionParameters, callback: Any, request_callback: Any = None
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription, with a limited publishing interval."""
        if len(self._own()) >= MAX_SUBSCRIPTIONS:
            raise ServiceError(ua.StatusCodes.BadTooManySubscriptions)
        interval_ms = params.RequestedPublishingInterval
        if not MIN_PUBLISHING_MS <= interval_ms <= MAX_PUBLISHING_MS:  # also for NaN
            interval_ms = MIN_PUBLISHING_MS if not interval_ms > MAX_PUBLISHING_MS else MAX_PUBLISHING_MS
        params.RequestedPublishingInterval = interval_ms
        return await super().create_subscription(params, callback, request_callback)

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """Create items in one of its subscriptions."""
        self._check(params.SubscriptionId)
        _limit(params.ItemsToCreate)
        for item in params.ItemsToCreate:
            if item.ItemToMonitor.AttributeId == ua.AttributeIds.Value:
                # a coordinate still in the queue when the next one follows has expired
                item.RequestedParameters.QueueSize = 1
        if isinstance(self.iserver, Server):
            await self.iserver.refresh()
        # asyncua offers no other way to count them
        held = sum(len(sub.monitored_item_srv._monitored_items) for sub in self._own())  # noqa: SLF001  # as said
        if held + len(params.ItemsToCreate) > MAX_ITEMS:
            raise ServiceError(ua.StatusCodes.BadTooManyMonitoredItems)
        return await super().create_monitored_items(params)

    async def modify_monitored_items(
        self, params: ua.ModifyMonitoredItemsParameters
    ) -> list[ua.MonitoredItemModifyResult]:
        """Modify items of one of its subscriptions; the queue size of values stays 1."""
        self._check(params.SubscriptionId)
        _limit(params.ItemsToModify)
        for item in params.ItemsToModify:
            if not isinstance(item.RequestedParameters.Filter, ua.EventFilter):
                item.RequestedParameters.QueueSize = 1
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(self, params: ua.DeleteMonitoredItemsParameters) -> list[ua.StatusCode]:
        """Delete items of one of its subscriptions."""
        self._check(params.SubscriptionId)
        _limit(params.MonitoredItemIds)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(self, params: ua.SetMonitoringModeParameters) -> list[ua.StatusCode]:
        """Set the monitoring mode of items of one of its subscriptions."""
        self._check(params.SubscriptionId)
        _limit(params.MonitoredItemIds)
        return await super().set_monitoring_mode(params)

    async def set_publishing_mode(self, params: ua.SetPublishingModeParameters) -> list[ua.StatusCode]:
        """Set the publishing mode of its own subscriptions."""
        self._check(*params.SubscriptionIds)
        return await super().set_publishing_mode(params)

    def modify_subscription(self, params: ua.ModifySubscriptionParameters) -> ua.ModifySubscriptionResult:
        """Modify one of its own subscriptions."""
        self._check(params.SubscriptionId)
        return super().modify_subscription(params)

    async def delete_subscriptions(self, ids: list[int]) -> list[ua.StatusCode]:
        """Delete its own subscriptions."""
        self._check(*ids)
        return await super().delete_subscriptions(ids)

    def republish(self, params: ua.RepublishParameters) -> ua.NotificationMessage:
        """Send a message of one of its own subscriptions again."""
        self._check(params.SubscriptionId)
        return super().republish(params)

    def publish(self, acks: Any = None) -> tuple[int, list[ua.StatusCode]]:
        """Acknowledge messages of its own subscriptions."""
        if not self._own():
            raise ServiceError(ua.StatusCodes.BadNoSubscription)
        known = self.subscription_service.subscriptions
        own = [ack for ack in acks or () if self._is_own(known.get(ack.SubscriptionId))]
        _, results = super().publish(own)
        return len(self._own()), results

    def _own(self) -> list[Any]:
        return [sub for sub in self.subscription_service.subscriptions.values() if self._is_own(sub)]

    def _is_own(self, subscription: Any) -> bool:
        return subscription is not None and subscription.session_id == self.session_id

    def _check(self, *ids: int) -> None:
        _limit(ids)
        known = self.subscription_service.subscriptions
        if not all(self._is_own(known.get(number)) for number in ids):
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)


def _limit(operations: Any) -> None:
    if len(operations or ()) > MAX_NODES:
        raise ServiceError(ua.StatusCodes.BadTooManyOperations)


class Processor(UaProcessor):
    """Processes the requests of one connection, after checking that they are allowed."""

    @property
    def is_active(self) -> bool:
        """Whether a user is logged in."""
        return self.session is not None and self.session.is_activated()

    async def _process_message(self, typeid: ua.NodeId, requesthdr: Any, seqhdr: Any, body: Any) -> Any:
        number = typeid.Identifier if typeid.NamespaceIndex == 0 else None
        server = self.iserver
        # the peer's certificate would not prove it: a client may send one without encrypting
        is_encrypted = self._connection.security_policy.Mode == ua.MessageSecurityMode.SignAndEncrypt
        if number not in DISCOVERY:
            if number not in OPENING and number not in SERVICES:
                raise ServiceError(ua.StatusCodes.BadServiceUnsupported)
            if not is_encrypted and not (isinstance(server, Server) and server.anonymous):
                raise ServiceError(ua.StatusCodes.BadSecurityPolicyRejected)
            if number in SERVICES and not self.is_active:
                raise ServiceError(ua.StatusCodes.BadSessionNotActivated)
            if number in SERVICES and (
                self.session is None or requesthdr.AuthenticationToken != self.session.auth_token
            ):
                raise ServiceError(ua.StatusCodes.BadSessionIdInvalid)
        if number == _S.CreateSessionRequest_Encoding_DefaultBinary and self.session is not None:
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        if number == _S.ActivateSessionRequest_Encoding_DefaultBinary and isinstance(server, Server):
            # nothing else runs between here and `Users.get_user`
            server.users.peer = str(self.name[0]) if self.name else "?"
            server.users.is_encrypted = is_encrypted
        return await super()._process_message(typeid, requesthdr, seqhdr, body)

    async def close(self) -> None:
        """Close the connection's session, too."""
        await super().close()
        if self.session is not None:
            await self.session.close_session(True)
