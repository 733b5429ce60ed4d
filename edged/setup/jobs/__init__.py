"""Background jobs: a worker process, and how far its tasks are."""
