"""The stage of `edged demo --stage`: what stands before virtual cameras, moved over HTTP."""
