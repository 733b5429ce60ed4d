"""Values of edged as CBOR and back, between its own processes: a closed list of kinds for each link."""
