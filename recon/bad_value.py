"""What is wrong with a value that was written by a person, in a person's words: those of the checks name types of Python."""

import json

from pydantic import ValidationError
from pydantic_core import ErrorDetails

# By pydantic's names of its errors, https://docs.pydantic.dev/latest/errors/validation_errors; filled in from their context.
WORDS = {
    "missing": "is missing",
    "extra_forbidden": "there is no such value; check the spelling",
    "int_parsing": "must be a whole number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "int_parsing_size": "must be a whole number of fewer digits",
    "float_parsing": "must be a number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be {ge:g} or more",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be {le:g} or less",
    "bool_parsing": "must be true or false",
    "bool_type": "must be true or false",
    "string_type": "must be text",
    "string_too_short": "must not be empty",
    "literal_error": "must be {expected}",
    "union_tag_invalid": "must be one of {expected_tags}",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "dict_type": "must be a group of named values",
    "model_type": "must be a group of named values",
    "model_attributes_type": "must be a group of named values",
    "value_error": "{error}",
}


def reason_of(fault: ErrorDetails) -> str:
    """Return what is wrong with one value, and what was found in its place."""
    kind, context = fault["type"], fault.get("ctx", {})
    if kind in ("too_short", "too_long"):
        number = context.get("min_length", context.get("max_length"))
        return f"must have {number} values at {'least' if kind == 'too_short' else 'most'}, found {context['actual_length']}"
    reason = WORDS[kind].format(**context) if kind in WORDS else fault["msg"]
    found = fault["input"]
    told = kind in ("missing", "extra_forbidden", "json_invalid") or (kind == "value_error" and str(found) in reason)
    return f"{reason}, found {_written(found)}" if isinstance(found, str | int | float | None) and not told else reason


def _written(found: object) -> str:
    """Return a value as it stands in the file, JSON or TOML, and text in the quotes of all messages."""
    return json.dumps(found) if found is None or isinstance(found, bool) else repr(found)


def first_fault(error: ValidationError, *, whole: str) -> str:
    """Say which value is wrong first and why; ``whole`` stands for it where it is no single one."""
    fault = error.errors()[0]
    where = ".".join(str(part) for part in fault["loc"]) or whole
    return f"{where}: {reason_of(fault)}"
