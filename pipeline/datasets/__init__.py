"""Public light-stage sets, read as they ship.

There is a module per set, with others beside it, and what several of them share.

A reader returns an `ImportedCapture`, in this project's conventions; `native` writes it as a capture whose images stay
where they are.
"""
