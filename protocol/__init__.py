"""The wire of scalebridge: messages, frames, client, server, errors, security and conformance.

`SPEC.md` beside this file states the whole contract in words and tables, so that a service can be
written in any language from it alone.
"""
