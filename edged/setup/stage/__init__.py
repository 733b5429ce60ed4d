"""The stage of `edged demo --stage`: objects in front of virtual cameras, moved over HTTP."""
