from . import places, point_table, tasks

__all__ = [
    "places",
    "point_table",
    "tasks",
]
