# SPDX-License-Identifier: Apache-2.0
"""Results against their schema."""

import json
from functools import cache

from jsonschema import Draft202012Validator

from stack_counter.display.result_schema import result_schema


@cache
def checked_schema():
    """The schema, valid as such, which takes longer to check than a result."""
    schema = result_schema()
    Draft202012Validator.check_schema(schema)
    return schema


def read_result(text, kind="result"):
    """Reads JSON that must be valid by one of the schema's definitions; NaN is no JSON."""
    def refuse(constant):
        raise AssertionError(f"{constant} in {text}")

    value = json.loads(text, parse_constant=refuse)
    schema = checked_schema()
    Draft202012Validator({"$ref": f"#/$defs/{kind}", "$defs": schema["$defs"]}).validate(value)
    Draft202012Validator(schema).validate(value)
    return value
