"""Sweeps: many settings times many scenes, resumable, on one machine or many."""
