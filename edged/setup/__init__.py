"""Setting up a cell: everything that users and pages do before and besides measuring."""
