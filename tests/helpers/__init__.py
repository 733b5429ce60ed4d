"""What several tests share: cells, robots, parts, interpreters of robot languages, clients."""
