"""Attacks on stages and the workflow, each with a class of its outcome; `make chaos` runs all of them.

    python -m tests.chaos --parts captures settings kills surroundings twice --out results/chaos

- `outcome`: what an attack is, and the classes of what came of it.
- `forked_stage`: a stage's command in a forked child, with limits, and killed at any write.
- `sound_run`: the run of tiny that attacks start from and are compared with.
- `mutations`: what may be wrong with a capture, file by file, and whether it has to be refused.
- `captures`, `settings`, `kills`, `surroundings`, `twice`: the parts.
- `records`: outcomes kept in a table, so that a run that was ended goes on.

The parts import no stage: they start them. `tests.chaos` runs them: as a program all, as ordinary tests some.
"""
