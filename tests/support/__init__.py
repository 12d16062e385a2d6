"""Planted truth and hand-made inputs that several test modules share.

- `captures`: whole captures in files, valid or broken, and the index of a posed or walking one.
- `drawings`: images of mirror balls, calibration boards and colour charts, drawn without the pipeline.
- `figures`: a jointed figure, its motion, its masks and its painted images.
- `rigs`: cameras with planted poses, camera files of other programs, and a light stage with a planted log.
- `meshes`: .glb files byte by byte, and meshes with lights around them.
- `avatars`: small atlases, frames and images to train on, eyes, heads, and a splat viewer of its own.
- `naive`: textbook formulas that hard cases break.
- `results`: hand-made curves and results of subjects, and the table of hard cases.
- `chaos`: attacks on stages and the workflow.
- `workflow`: copies of the project, and Snakemake without its start.
- `order`: which files of tests are handed out first.
- `shared_data`: data that lies beside the repository.

No test module imports another: what two of them need stands here.
"""
