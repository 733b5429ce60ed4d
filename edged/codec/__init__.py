"""Encoding of values as CBOR between processes of edged: a closed list of types for each link."""
