"""Mitsuba: backend, scenes, renders, images and their differences. `backend` alone imports mitsuba and drjit."""
