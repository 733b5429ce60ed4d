"""Setting a cell up: what people and pages do before, and beside, its measuring."""
