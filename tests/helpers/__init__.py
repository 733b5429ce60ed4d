"""Code shared by several tests: cells, robots, parts, interpreters of robot languages, clients."""
