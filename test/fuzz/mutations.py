# SPDX-License-Identifier: Apache-2.0
"""Changes at random: of bytes, and of what a YAML or JSON document says."""

import json
from copy import deepcopy

import numpy as np
import yaml

ODD_NUMBERS = [float("nan"), float("inf"), -1.0, 1e300, 1e-300]
# What may stand where a document has something else. Texts: an empty one, a long one, a date that
# is none, a path that leads away.
ODD_VALUES = [*ODD_NUMBERS, 0, -1, 1, 2**63, 10**400, 0.5, True, None, "", "x" * 999, "2001-99-99",
              "../..", [], {}, [[]], [None], {"a": 1}, {1: 2}, [1e9] * 40]


def mutated(data, chance):
    """The bytes with one to four numbers in them replaced.

    Args:
        data: of a message: its first four say how it is serialised, and stay.
        chance: a `random.Random`.
    """
    changed = bytearray(data)
    for _ in range(chance.choice([1, 1, 2, 4])):
        width, at = chance.choice([1, 4, 8]), chance.randrange(4, len(data))
        value = chance.choice([bytes([chance.randrange(256)]) * width, b"\xff" * width,
                               bytes(width),
                               np.float64(chance.choice(ODD_NUMBERS)).tobytes()[:width]])
        changed[at:at + len(value)] = value
    return bytes(changed)


def cut_or_mutated(data, chance):
    """The bytes with numbers replaced, of every fourth file cut short as well."""
    data = mutated(data, chance) if len(data) > 4 else data
    return data[:chance.randrange(len(data))] if data and chance.random() < 0.25 else data


def mutated_document(data, chance, load=yaml.safe_load):
    """The document with one value replaced, removed or moved elsewhere; JSON is YAML.

    Raises:
        Exception: it is no document.
    """
    document = load(data.decode())
    place, key = chance.choice(_places({"": document}))
    other_place, other_key = chance.choice(_places({"": document}))
    if (what := chance.random()) < 0.2 and key != "":
        del place[key]
    elif what < 0.4:
        place[key] = deepcopy(other_place[other_key])
    elif what < 0.5 and isinstance(place, dict) and key != "":
        place[chance.choice(["x", "", 1, None, True])] = place.pop(key)
    else:
        place[key] = chance.choice(ODD_VALUES)
        if key == "":
            document = place[key]
    if load is json.loads:
        return json.dumps(document).encode()
    return yaml.safe_dump(document, allow_unicode=True).encode()


def _places(holder):
    """Every (mapping or list, key or number) of what a mapping or list holds."""
    found = []
    for key, value in list(holder.items() if isinstance(holder, dict) else enumerate(holder)):
        found.append((holder, key))
        if isinstance(value, (dict, list)):
            found += _places(value)
    return found
