"""The coordinator: reads a scene, starts the services it needs, drives the M:1 coupling, writes results."""
