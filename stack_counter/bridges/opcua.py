# SPDX-License-Identifier: Apache-2.0
"""Results in an OPC UA server: a node for each value of a flat result."""

from __future__ import annotations

import asyncio
import hmac
import logging
from collections.abc import Mapping
from datetime import UTC
from pathlib import Path
from typing import Any

from asyncua import Node, Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.user_managers import UserManager

from stack_counter.bridges.settings import OpcuaConfig, password_of
from stack_counter.display.result_schema import FLAT_FIELDS, Schema
from stack_counter.errors import ConfigError

_LOGGER = logging.getLogger(__name__)
NAMESPACE_URI = "urn:stack_counter:results"
APPLICATION_URI = "urn:stack_counter:bridge"  # a certificate names it
ROOT = "StackCounter"
_TYPES = {"integer": ua.VariantType.Int64, "number": ua.VariantType.Double,
          "string": ua.VariantType.String, "boolean": ua.VariantType.Boolean}
_ANY_VALUE = {ua.VariantType.Int64: 0, ua.VariantType.Double: 0.0, ua.VariantType.String: "",
              ua.VariantType.Boolean: False}
_NO_DATA = ua.StatusCode(ua.UInt32(ua.StatusCodes.BadNoData))


class OpcuaSink:
    """Serves the last result of each region, read only."""

    def __init__(self, config: OpcuaConfig):
        """Listens on nothing yet.

        Raises:
            ConfigError: there is no password, or a certificate is not there.
        """
        self._config, self._password = config, password_of(config)
        for path in filter(None, (config.certificate_file, config.key_file)):
            if not Path(path).is_file():
                raise ConfigError(f"opcua: no file {path}; expected a certificate and its key")
        self._news: asyncio.Queue[Mapping[str, Any] | bool] = asyncio.Queue()
        self._fields: dict[str, dict[str, Node]] = {}  # by region and name

    def put(self, result: Mapping[str, Any]) -> None:
        """Has a flat result shown in the nodes of its region."""
        self._news.put_nowait(result)

    def set_available(self, available: bool) -> None:
        """Has it shown whether a counter is there."""
        self._news.put_nowait(available)

    async def run(self) -> None:
        """Serves until it is cancelled.

        Raises:
            ConfigError: nothing can listen there, or the certificate cannot be used.
        """
        server = await self._make_server()
        available = await self._add_nodes(server)
        try:
            await server.start()
        except OSError as error:
            raise ConfigError(f"opcua: cannot listen on {self._config.host}:{self._config.port} "
                              f"({error}); expected an address of this machine and a port that "
                              "is free") from error
        try:
            _LOGGER.info("opcua: listening on %s", server.endpoint.geturl())
            while True:
                news = await self._news.get()
                if isinstance(news, bool):
                    await server.write_attribute_value(available.nodeid, ua.DataValue(
                        ua.Variant(news), SourceTimestamp=ua.DateTime.now(UTC)))
                else:
                    await self._show(server, news)
        finally:
            await server.stop()

    async def _make_server(self) -> Server:
        """Returns the server, which asks for what the settings say. Raises ConfigError."""
        c = self._config
        # Its start logs with a traceback what it raises.
        logging.getLogger("asyncua.server.server").setLevel(logging.CRITICAL)
        server = Server(user_manager=_OneUser(c.username, self._password))
        await server.init()
        await server.set_application_uri(APPLICATION_URI)
        server.set_server_name("stack_counter")
        server.set_endpoint(f"opc.tcp://{c.host}:{c.port}/stack_counter")
        policy = ua.SecurityPolicyType.NoSecurity
        if c.certificate_file:
            policy = ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt
            try:
                await server.load_certificate(c.certificate_file)
                await server.load_private_key(c.key_file)
            except (OSError, ValueError) as error:
                raise ConfigError(f"opcua: {c.certificate_file} or {c.key_file} cannot be used: "
                                  f"{error}; expected PEM or DER files") from error
        server.set_security_policy([policy])
        server.set_identity_tokens([ua.UserNameIdentityToken if c.username
                                    else ua.AnonymousIdentityToken])
        return server

    async def _add_nodes(self, server: Server) -> Node:
        """Adds the nodes of all regions that are known; returns that of the availability."""
        self._index = await server.register_namespace(NAMESPACE_URI)
        root = await server.nodes.objects.add_object(self._id(ROOT), self._name(ROOT))
        available = await root.add_variable(self._id(ROOT, "available"), self._name("available"),
                                            False)
        await _describe(available, "whether a counter is there")
        self._root = root
        for region in self._config.regions or ("",):
            await self._add_fields(region)
        return available

    async def _add_fields(self, region: str) -> dict[str, Node]:
        """Adds a node for each value of a region, none of which has one yet."""
        if region in self._fields:
            return self._fields[region]
        parent, path = self._root, [ROOT]
        if region:
            path += [region]
            parent = await parent.add_object(self._id(*path), self._name(region))
        nodes = {}
        for name, schema in FLAT_FIELDS.items():
            kind = _variant_type(schema)
            nodes[name] = await parent.add_variable(
                self._id(*path, name), self._name(name), _ANY_VALUE[kind], kind)
            await nodes[name].write_value(_data_value(None, kind, None))
            await _describe(nodes[name], schema["description"])
        self._fields[region] = nodes
        return nodes

    async def _show(self, server: Server, result: Mapping[str, Any]) -> None:
        """Writes all values of a result, each with the stamp of its last view."""
        stamp = ua.DateTime.fromisoformat(result["stamp"].replace("Z", "+00:00"))
        for name, node in (await self._add_fields(result["region"])).items():
            await server.write_attribute_value(node.nodeid, _data_value(
                result.get(name), _variant_type(FLAT_FIELDS[name]), stamp))

    def _id(self, *path: str) -> ua.NodeId:
        return ua.NodeId(ua.String(".".join(path)), ua.Int16(self._index))

    def _name(self, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self._index)


class _OneUser(UserManager):
    """Lets one user in, or anybody if none is named; nobody may write."""

    def __init__(self, name: str, password: str | None):
        self._name, self._password = name, password or ""

    def get_user(self, iserver: Any, username: str | None = None, password: str | None = None,
                 certificate: Any = None) -> User | None:
        """Returns the user of a session; None: it is refused."""
        if self._name and not (username == self._name and hmac.compare_digest(
                (password or "").encode(), self._password.encode())):
            return None
        return User(role=UserRole.User)


def _variant_type(schema: Schema) -> ua.VariantType:
    """Returns the OPC UA type of a value by its schema; null is a value without data."""
    kinds = schema.get("type", "string")
    kind = next(k for k in kinds if k != "null") if isinstance(kinds, list) else kinds
    return _TYPES["integer" if isinstance(schema.get("const"), int) else kind]


def _data_value(value: Any, kind: ua.VariantType, stamp: ua.DateTime | None) -> ua.DataValue:
    """Returns a value with its source timestamp; for None, the status BadNoData."""
    if value is None:
        return ua.DataValue(ua.Variant(), StatusCode=_NO_DATA, SourceTimestamp=stamp)
    return ua.DataValue(ua.Variant(float(value) if kind == ua.VariantType.Double else value, kind),
                        SourceTimestamp=stamp)


async def _describe(node: Node, text: str) -> None:
    await node.write_attribute(ua.AttributeIds.Description, ua.DataValue(
        ua.Variant(ua.LocalizedText(text))))
