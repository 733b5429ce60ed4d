"""A live cell served over OPC UA, and certificates for it and its clients."""

from __future__ import annotations

import asyncio
import datetime
import gc
import pickle
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

from argon2 import PasswordHasher
from asyncua import Client
from asyncua.server.address_space import NodeManagementService
from asyncua.server.standard_address_space import standard_address_space
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from edged.adapters.modbus import ModbusSettings
from edged.adapters.opcua import OpcUaPublisher, OpcUaSettings, space
from edged.adapters.opcua.model import Model
from edged.adapters.opcua.nodes import Nodes
from helpers.livecell import LiveCell
from helpers.waiting import LIMIT_S

PASSWORD = "a password for tests"
PASSWORD_HASH = PasswordHasher(time_cost=1, memory_cost=512, parallelism=1).hash(PASSWORD)
"""Hashed with cheap parameters."""
JOBS = [(1, "job1"), (2, "job2")]


def client_of(url: str) -> Client:
    """A patient client: asyncua's own closes the connection when a busy machine is silent for a second."""
    return Client(url, timeout=LIMIT_S, watchdog_intervall=LIMIT_S)


def make_certificate(folder: Path, name: str, uri: str, *, days: int = 2) -> None:
    """Write `name`.pem, .der, .key and .key.der: an application certificate as OPC 10000-6, 6.2.2 asks."""
    key = rsa.generate_private_key(65537, 2048)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.UTC)
    begins = now - datetime.timedelta(days=3)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begins)
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(
            x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri), x509.DNSName("localhost")]),
            critical=False,
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(
            x509.KeyUsage(
                digital_signature=True,
                content_commitment=True,
                key_encipherment=True,
                data_encipherment=True,
                key_agreement=False,
                key_cert_sign=True,
                crl_sign=False,
                encipher_only=False,
                decipher_only=False,
            ),
            critical=True,
        )
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]),
            critical=False,
        )
        .sign(key, hashes.SHA256())
    )
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(Encoding.PEM))
    (folder / f"{name}.der").write_bytes(certificate.public_bytes(Encoding.DER))
    for suffix, encoding in (("key", Encoding.PEM), ("key.der", Encoding.DER)):
        data = key.private_bytes(encoding, PrivateFormat.TraditionalOpenSSL, NoEncryption())
        (folder / f"{name}.{suffix}").write_bytes(data)


def secure_settings(folder: Path, *, anonymous: bool = False) -> OpcUaSettings:
    """Settings with certificates in the folder; the client `friend` is trusted."""
    trusted = folder / "trusted"
    trusted.mkdir()
    make_certificate(folder, "server", "urn:edged:cell1")
    for name in ("friend", "stranger"):
        make_certificate(folder, name, f"urn:test:{name}")
    (trusted / "friend.der").write_bytes((folder / "friend.der").read_bytes())
    return OpcUaSettings(
        "cell1",
        port=0,
        certificate=folder / "server.pem",
        key=folder / "server.key",
        trusted=trusted,
        password_hash=PASSWORD_HASH,
        anonymous=anonymous,
    )


@cache
def remember_standard_nodes() -> None:
    """Make asyncua build the 6,000 nodes of the standard only once; it takes three quarters of a second.

    And those of the companion specification that each cell adds to them.
    """
    make, add_types = standard_address_space.fill_address_space, space.add_types
    made, types = list[bytes](), list[bytes]()

    def fill(service: NodeManagementService) -> None:
        nodes = vars(vars(service)["_aspace"])
        if made:
            nodes["_nodes"] = loaded(made[0])
        else:
            make(service)
            made.append(pickle.dumps(nodes["_nodes"], pickle.HIGHEST_PROTOCOL))

    def add(nodes: Nodes, model: Model) -> None:
        here = vars(vars(nodes)["_server"].aspace)["_nodes"]
        if types:
            new, more = loaded(types[0])
            here.update(new)
            for node, references in more.items():
                here[node].references += references
            return
        before = {node: len(data.references) for node, data in here.items()}
        add_types(nodes, model)
        new = {node: data for node, data in here.items() if node not in before}
        more = {node: here[node].references[many:] for node, many in before.items()}
        both = new, {node: references for node, references in more.items() if references}
        types.append(pickle.dumps(both, pickle.HIGHEST_PROTOCOL))

    standard_address_space.fill_address_space = fill
    space.add_types = add


def loaded(pickled: bytes) -> Any:
    """Unpickle without garbage collection."""
    gc.disable()  # the garbage collector would take longer than building the nodes
    try:
        return pickle.loads(pickled)
    finally:
        gc.enable()


class OpcUaCell(LiveCell):
    """A live cell with OPC UA. Use it as a context."""

    def __init__(
        self, settings: OpcUaSettings, modbus: ModbusSettings | None = None, period_s: float | None = None
    ) -> None:
        super().__init__(modbus, period_s)
        remember_standard_nodes()
        self.jobs = list(JOBS)
        self.publisher = OpcUaPublisher(settings, lambda: self.server, lambda: self.jobs)

    def __enter__(self) -> OpcUaCell:
        super().__enter__()
        asyncio.run_coroutine_threadsafe(self.publisher.start(), self.loop).result(LIMIT_S)
        # before Modbus, though it shows what Modbus recorded: the order must not matter
        self.call(lambda: self.cycle.set_publishers([self.publisher, self.server]))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        server = vars(self.publisher)["_server"]
        asyncio.run_coroutine_threadsafe(self.publisher.close(), self.loop).result(LIMIT_S)
        # otherwise they form a garbage cycle, which takes ten times as long to find and free
        vars(vars(vars(server)["_space"])["_nodes"])["_server"].aspace.clear()
        super().__exit__(kind, error, trace)

    @property
    def url(self) -> str:
        """Where clients connect."""
        return f"opc.tcp://127.0.0.1:{self.publisher.port}"
