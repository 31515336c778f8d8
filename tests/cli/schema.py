"""As much of JSON Schema 2020-12 as docs/format/*.schema.json use: check(value, schema) returns what is wrong, as a list of lines. An unknown keyword is an error, so that
nothing in a schema goes unchecked."""

import re

KNOWN = {"$schema", "$defs", "$ref", "title", "description", "type", "properties", "required", "additionalProperties", "items", "minItems", "maxItems", "minimum", "maximum",
         "enum", "const", "pattern", "allOf", "anyOf", "if", "then", "else"}


def is_type(v, name):
    number = isinstance(v, (int, float)) and not isinstance(v, bool)
    return {"object": isinstance(v, dict), "array": isinstance(v, list), "string": isinstance(v, str), "boolean": isinstance(v, bool), "null": v is None,
            "number": number, "integer": number and int(v) == v}[name]


def check(v, s, root=None, at="$"):
    root = s if root is None else root
    unknown = set(s) - KNOWN
    if unknown:
        return ["%s: the schema has unknown keywords %s" % (at, unknown)]
    out = []
    if "$ref" in s:
        target = root
        for part in s["$ref"].lstrip("#/").split("/"):
            target = target[part]
        out += check(v, target, root, at)
    if "type" in s:
        names = s["type"] if isinstance(s["type"], list) else [s["type"]]
        if not any(is_type(v, n) for n in names):
            return out + ["%s: %r is no %s" % (at, v, " or ".join(names))]
    if "enum" in s and v not in s["enum"]:
        out.append("%s: %r is none of %s" % (at, v, s["enum"]))
    if "const" in s and (v != s["const"] or isinstance(v, bool) != isinstance(s["const"], bool)):
        out.append("%s: %r is not %r" % (at, v, s["const"]))
    if isinstance(v, str) and "pattern" in s and not re.search(s["pattern"], v):
        out.append("%s: %r does not match %s" % (at, v, s["pattern"]))
    if is_type(v, "number"):
        if "minimum" in s and v < s["minimum"] or "maximum" in s and v > s["maximum"]:
            out.append("%s: %r is out of range" % (at, v))
    if isinstance(v, list):
        if len(v) < s.get("minItems", 0) or len(v) > s.get("maxItems", len(v)):
            out.append("%s: %d items" % (at, len(v)))
        for i, e in enumerate(v):
            out += check(e, s.get("items", {}), root, "%s[%d]" % (at, i))
    if isinstance(v, dict):
        out += ["%s: no %s" % (at, k) for k in s.get("required", []) if k not in v]
        for k, e in v.items():
            if k in s.get("properties", {}):
                out += check(e, s["properties"][k], root, at + "." + k)
            elif s.get("additionalProperties") is False:
                out.append("%s: %s is not in the schema" % (at, k))
            elif isinstance(s.get("additionalProperties"), dict):
                out += check(e, s["additionalProperties"], root, at + "." + k)
    for part in s.get("allOf", []):
        out += check(v, part, root, at)
    if "anyOf" in s and all(check(v, part, root, at) for part in s["anyOf"]):
        out.append("%s: %r fits nothing" % (at, v))
    if "if" in s:
        out += check(v, s.get("then" if not check(v, s["if"], root, at) else "else", {}), root, at)
    return out
