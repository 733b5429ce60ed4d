"""Two cameras that answer as one: trigger both, prove one exposure, reopen what broke."""
