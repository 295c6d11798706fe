# SPDX-License-Identifier: Apache-2.0
"""The JSON schema of a result: of `replay --json`, of the lines of `result_log`, and flat.

A flat result has every number and text of a line under a name of its own, as `views.used`: these
are the columns of a log in CSV, the JSON of `result_json`, and the nodes of an OPC UA server.

`stack-counter replay --json-schema` prints it, docs/result.schema.json is what that prints. A key
that is new leaves the version as it is: who reads results ignores keys it does not know.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from stack_counter.types import CONTAINER_KINDS

SCHEMA_VERSION = 1  # grows when a key goes away or changes its meaning
STAGES = ("load", "read", "segment", "integrate", "finish", "gamma", "total")

Schema = dict[str, Any]


def _value(kind: str, text: str, **limits: Any) -> Schema:
    return {"type": kind, "description": text, **limits}


def _numbers(length: int, text: str, kind: str = "number") -> Schema:
    """The schema of an array of so many numbers."""
    return {"type": "array", "description": text, "items": {"type": kind},
            "minItems": length, "maxItems": length}


def _object(properties: Mapping[str, Schema], optional: Iterable[str] = ()) -> Schema:
    """The schema of an object with all these keys, but for those that are optional."""
    return {"type": "object", "properties": dict(properties),
            "required": [key for key in properties if key not in set(optional)]}


def _texts(text: str) -> Schema:
    return {"type": "array", "description": text, "items": {"type": "string"}}


def _numbers_by_name(kind: str, text: str) -> Schema:
    return {"type": "object", "description": text,
            "additionalProperties": {"type": kind, "minimum": 0}}


_NUMBER = _value("integer", "parts in the stack", minimum=0)
_INTERVAL = _numbers(2, "lowest and highest number of parts, inclusive", "integer")
_VERSION = {"const": SCHEMA_VERSION, "description": "version of this schema"}
_POSE = _object({"position_m": _numbers(3, "x, y, z in the world frame, m"),
                 "quaternion_xyzw": _numbers(4, "x, y, z, w")})
_CONTAINER = _object({
    "kind": {"enum": list(CONTAINER_KINDS), "description": "what holds the parts"},
    "inner_size_m": _numbers(3, "x and y at the rim, height from floor to rim, m; zeros: unknown"),
    "wall_thickness_m": _value("number", "m", minimum=0),
    "floor_thickness_m": _value("number", "m", minimum=0),
    "pose": _POSE})
_VIEWS = _object({
    "received": _value("integer", "views that arrived", minimum=0),
    "used": _value("integer", "views that the count rests on", minimum=0),
    "skipped": _numbers_by_name("integer", "views that were left out, by reason")})
_RANGE = _object({name: {"type": ["number", "null"], "description": f"{what} of its places; null "
                                                                     "beside the opening"}
                  for name, what in (("min", "1st percentile"), ("max", "99th percentile"),
                                     ("mean", "mean"))})
_CELL = _object({
    "cell_size": _object({axis: _value("number", "side along the container's axis, m")
                          for axis in "xy"}),
    "cell_position": _object({axis: _value("number", "of its centre at the rim, world, m")
                              for axis in "xyz"}),
    "level_in_percent": {**_RANGE, "description": "filled share of the height from the inner "
                                                  "surface to the rim: 100 is full"},
    "level_free_in_meters": {**_RANGE, "description": "from the surface up to the rim, m; below 0 "
                                                      "over the rim"},
    "coverage": _value("number", "share of it that some view saw", minimum=0, maximum=1)})
_CELLS = {
    "cells_filling_levels": {"type": "array", "items": _CELL, "description":
                             "how full each cell of a grid on the floor is, along the container's "
                             "x first; empty without a container"},
    "filling_level_cell_count": _object({axis: _value(
        "integer", "cells along the container's axis", minimum=0) for axis in "xy"}),
}
_SOURCES = {"type": "array", "description": "what each source alone says, vision first",
            "items": _object({
                "source": _value("string", "vision or weight"),
                "count": _NUMBER, "count_interval": _INTERVAL,
                "share": _value("number", "how much it weighs in count", minimum=0, maximum=1)})}
_COUNT = {
    "count": _NUMBER,
    "count_interval": _INTERVAL,
    "confidence": _value("number", "probability that the interval holds the true count",
                         minimum=0, maximum=1),
    "gamma": _value("number", "occupancy ratio", minimum=0),
    "gamma_std": _value("number", "its standard deviation", minimum=0),
    "volume_m3": _value("number", "volume of the stack V, m3", minimum=0),
    "volume_std_m3": _value("number", "its standard deviation, m3", minimum=0),
    "unit_volume_m3": _value("number", "volume of one part v, m3", exclusiveMinimum=0),
    "container": _CONTAINER,
    "views": _VIEWS,
    "view_agreement_mm": _value("number", "median distance between the views' surfaces, mm; 0: "
                                          "unknown", minimum=0),
    "coverage": _value("number", "share of the container's footprint that some view saw",
                       minimum=0, maximum=1),
    "fill_level": _numbers(3, "least, mean and largest filled share of the inner height"),
    "overfilled": _value("boolean", "parts stand above the rim"),
    "overall_filling_level": {**_CELL, "type": ["object", "null"],
                              "description": "of the whole container; null without one"},
    "count_sources": _SOURCES,
    "net_weight_kg": {"type": ["number", "null"],
                      "description": "weight of the parts, kg; null: none was used"},
    "visible_count": {"type": ["integer", "null"], "minimum": 0, "description":
                      "parts that show from straight above; null: none were looked for"},
    "estimator": _value("string", "who said gamma"),
    "gamma_shares": _numbers_by_name("number", "how much each source of gamma weighed"),
    "counted_scans": _value("integer", "counted scans of the part that gamma rests on",
                            minimum=0),
    "status": {"enum": ["ok", "degraded"], "description": "degraded: some reason weakens it"},
    "reasons": _texts("slugs of what qualifies the count: docs/reasons.md"),
    "seconds": _object({stage: _value("number", "s", minimum=0) for stage in STAGES}),
}
_VISIBLE_PARTS = {"visible_parts": {
    "type": ["array", "null"], "description": "parts that show from straight above, the surest "
                                              "first; null: none were looked for",
    "items": _object({
        "position_m": _numbers(3, "middle of what shows of it, and its mean height, world, m"),
        "outline_m": {"type": "array", "description": "x and y of the corners around the largest "
                                                      "piece of what shows of it, world, m",
                      "items": _numbers(2, "x, y")},
        "share_visible": _value("number", "share of it that shows, of what would if nothing lay "
                                          "on it", minimum=0, maximum=1),
        "score": _value("number", "how sure it is that a part is there", minimum=0,
                        maximum=1),
        "pose": {**_object({**_POSE["properties"], "fit": _value(
            "number", "how well the part's mesh explains the surface there", minimum=0,
            maximum=1)}), "type": ["object", "null"], "description":
                 "how the axes of its CAD file lie; null: not looked for, or not told"}},
        optional=["pose"])}}
_STAMP = _value("integer", "stamp of the view's image, or of the cycle, ns")
_MISSING = _texts("cameras of the rig that gave this cycle no view")
_NO_VALUE = {"type": "null"}
_ERROR = _value("string", "why there is no count, one line", minLength=1)
_COUNTS = {
    "type": "array", "description": "one entry for each view used (--live), or for each cycle",
    "items": {"anyOf": [
        _object({"stamp_ns": _STAMP, "count": _NUMBER, "count_interval": _INTERVAL,
                 "missing_cameras": _MISSING}, optional=["missing_cameras"]),
        _object({"stamp_ns": _STAMP, "count": _NO_VALUE, "count_interval": _NO_VALUE,
                 "error": _ERROR, "missing_cameras": _MISSING}, optional=["missing_cameras"])]}}
_FAILURE = {"count": _NO_VALUE, "status": {"const": "error"}, "error": _ERROR}
_LINE = {
    "schema_version": _VERSION,
    "scan_id": _value("string", "scan that was counted"),
    "stamp": _value("string", "stamp of the last view used: ISO 8601, UTC", format="date-time"),
    "region": _value("string", "named region; empty if none is named"),
    "part": _value("string", "name of the part; empty if only its volume was given"),
    "verdict": {"enum": ["none", "pass", "fail", "unsure"],
                "description": "the count against expected_count"},
}
_FLAT = _object({**_LINE, **_COUNT, "error": _ERROR,
                 "status": {**_COUNT["status"], "enum": ["ok", "degraded", "error"]}})
_ALWAYS = {*_LINE, "status"}  # what a flat result has where there is no count, too


def _single_values(schema: Schema, value: Any, name: str) -> Iterator[tuple[str, Schema, Any]]:
    """Gives name, schema and value of all that a value holds; None for each where it is None."""
    if "properties" in schema:
        for key, part in schema["properties"].items():
            yield from _single_values(part, (value or {}).get(key), f"{name}.{key}" if name
                                      else key)
    elif "maxItems" in schema:
        for index in range(schema["maxItems"]):
            yield (f"{name}.{index}", {**schema["items"], "description": schema["description"]},
                   value[index] if value is not None else None)
    elif schema.get("type") in ("object", "array"):
        yield (name, _value("string", f"{schema['description']}; JSON",
                            contentMediaType="application/json"),
               json.dumps(value) if value is not None else None)
    else:
        yield name, schema, value


# Schema of every value of a flat result, by its name, in the order in which they are written.
FLAT_FIELDS = {name: schema for name, schema, _ in _single_values(_FLAT, None, "")}
_DEFINITIONS = {
    "count": _object({"schema_version": _VERSION, **_COUNT}),
    "failure": _object(_FAILURE),
    "result": {"allOf": [{"$ref": "#/$defs/count"}, _object({**_CELLS, **_VISIBLE_PARTS,
                                                               "counts": _COUNTS})]},
    "regions": _object({
        "schema_version": _VERSION,
        "regions": {"type": "array", "items": {
            "allOf": [_object({"name": _value("string", "of the region")}),
                      {"anyOf": [{"$ref": "#/$defs/result"}, {"$ref": "#/$defs/failure"}]}]}}}),
    "log_line": {
        "allOf": [_object({**_LINE, "views": _VIEWS, "reasons": _COUNT["reasons"]}),
                  {"anyOf": [{"$ref": "#/$defs/count"}, {"$ref": "#/$defs/failure"}]}]},
    "flat": _object({name: field if name in _ALWAYS else {"anyOf": [field, _NO_VALUE]}
                     for name, field in FLAT_FIELDS.items()}),
}


def result_schema() -> Schema:
    """Returns the JSON schema (draft 2020-12) of every JSON that a count is written as."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"stack_counter result, version {SCHEMA_VERSION}",
        "description": "What `stack-counter replay --json` writes (result; regions where the "
                       "settings name some), a line of result_log (log_line), and what comes "
                       "on result_json (flat).",
        "anyOf": [{"$ref": f"#/$defs/{name}"}
                  for name in ("result", "regions", "log_line", "flat")],
        "$defs": _DEFINITIONS}


def flat_line(line: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values of a line of the log by the names of `FLAT_FIELDS`; all are there.

    Objects with fixed keys and arrays of fixed length have a name for each value, as `views.used`
    and `count_interval.0`; of other objects and arrays the value is their JSON. What the line does
    not have is None.
    """
    return {name: value for name, _, value in _single_values(_FLAT, line, "")}
