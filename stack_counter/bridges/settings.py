# SPDX-License-Identifier: Apache-2.0
"""Settings of the bridges: one YAML file, with a section `mqtt`, `opcua` or both.

`config/mqtt.yaml` and `config/opcua.yaml` are the documented defaults. Passwords stand in no file:
a setting names the environment variable that holds one.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stack_counter.config.setting_fields import build_section, setting
from stack_counter.errors import ConfigError
from stack_counter.files import parse_yaml


def _read_names(value: Any) -> tuple[str, ...]:
    """Reads a list of texts. Raises ConfigError: it is none."""
    if not isinstance(value, list) or not all(isinstance(name, str) and name for name in value):
        raise ConfigError(f"regions is {value!r}; expected a list of names, as [left, right]")
    return tuple(value)


@dataclass(frozen=True)
class MqttConfig:
    """Which broker gets the results, and how."""

    host: str = setting("127.0.0.1", "the broker's host name or address")
    port: int = setting(1883, "its port; with TLS usually 8883", 1, 65535)
    topic: str = setting("stack_counter", "what the topics begin with: TOPIC/result, "
                                          "TOPIC/REGION/result, TOPIC/availability")
    qos: int = setting(1, "quality of service of all messages", 0, 2)
    client_id: str = setting("", "how the broker knows this client, one at a time; empty: by "
                                 "chance")
    keepalive_s: int = setting(30, "the broker says offline after one and a half times as long "
                                   "without a sign of life, s", 1, 3600)
    username: str = setting("", "empty: none")
    password_variable: str = setting("STACK_COUNTER_MQTT_PASSWORD",
                                     "environment variable that holds the user's password")
    tls: bool = setting(False, "encrypt, and check the broker's certificate")
    ca_file: str = setting("", "certificates that the broker's is checked by (PEM); empty: those "
                               "of the system")
    certificate_file: str = setting("", "own certificate, for brokers that ask for one (PEM); "
                                        "empty: none")
    key_file: str = setting("", "its private key (PEM); empty: in certificate_file")

    def __post_init__(self) -> None:
        """Raises ConfigError where settings contradict each other."""
        if not self.topic or set(self.topic) & set("+#") or self.topic[0] == "$":
            raise ConfigError(f"mqtt topic is '{self.topic}'; expected a topic without + and #")
        if (self.ca_file or self.certificate_file) and not self.tls:
            raise ConfigError("mqtt has ca_file or certificate_file beside tls: false; expected "
                              "tls: true")


@dataclass(frozen=True)
class OpcuaConfig:
    """Where the OPC UA server listens, and who may read it."""

    host: str = setting("127.0.0.1", "address to listen on; 0.0.0.0: all of this machine")
    port: int = setting(4840, "its port", 1, 65535)
    regions: tuple[str, ...] = setting((), "named regions that have nodes before their first "
                                           "result; empty: one stack, without a name",
                                       read=_read_names)
    username: str = setting("", "empty: anybody may read")
    password_variable: str = setting("STACK_COUNTER_OPCUA_PASSWORD",
                                     "environment variable that holds the user's password")
    certificate_file: str = setting("", "the server's certificate (PEM or DER), with which all is "
                                        "signed and encrypted; empty: nothing is")
    key_file: str = setting("", "its private key (PEM or DER)")

    def __post_init__(self) -> None:
        """Raises ConfigError where settings contradict each other."""
        if bool(self.certificate_file) != bool(self.key_file):
            raise ConfigError("opcua has one of certificate_file and key_file; expected both or "
                              "none")
        if self.username and not self.certificate_file:
            raise ConfigError(f"opcua username is '{self.username}' without certificate_file; "
                              "expected one: the password would travel in clear")


@dataclass(frozen=True)
class BridgeConfig:
    """What a file sets up; at least one of both.

    Attributes:
        mqtt: broker that gets the results; None: none.
        opcua: server that offers them; None: none.
    """

    mqtt: MqttConfig | None = None
    opcua: OpcuaConfig | None = None


_SECTIONS: dict[str, type] = {"mqtt": MqttConfig, "opcua": OpcuaConfig}


def load_bridges(path: Path) -> BridgeConfig:
    """Reads a file of settings.

    Raises:
        ConfigError: not YAML, no section, or an unknown or bad setting in one.
        FileNotFoundError: no such file.
    """
    try:
        sections = parse_yaml(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(f"{path} is no YAML: {error}") from error
    if not isinstance(sections, Mapping) or not sections or set(sections) - set(_SECTIONS):
        seen = list(sections) if isinstance(sections, Mapping) else sections
        raise ConfigError(f"{path} has {seen!r}; expected a section mqtt, opcua or both")
    for name, values in sections.items():
        if not isinstance(values or {}, Mapping):
            raise ConfigError(f"{path}: {name} is {values!r}; expected settings with their values")
    return BridgeConfig(**{name: build_section(_SECTIONS[name], values or {})
                           for name, values in sections.items()})


def password_of(config: MqttConfig | OpcuaConfig) -> str | None:
    """Returns the password of the user whom settings name; None where they name none.

    Raises:
        ConfigError: there is no such environment variable.
    """
    if not config.username:
        return None
    password = os.environ.get(config.password_variable)
    if not password:
        raise ConfigError(f"username is '{config.username}' and there is no environment variable "
                          f"{config.password_variable}; expected the password in it")
    return password
