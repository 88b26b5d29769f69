"""Pictures of scenes and runs."""
