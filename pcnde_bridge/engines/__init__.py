"""Computing engines: where the numbers come from."""
