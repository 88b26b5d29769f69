"""Scenes, conditions and experiments: what a study runs and measures."""
