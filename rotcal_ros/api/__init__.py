"""The front door for Python: the functions behind the names of ``rotcal_ros``.

They are thin: each says in SI what goes in and what comes out, and calls the room that does it.
"""
