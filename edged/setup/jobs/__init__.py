"""Background jobs: a worker process, and the progress of its tasks."""
