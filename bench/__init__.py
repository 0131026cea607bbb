"""What the documentation claims, measured. Each is run as a module, in a clone of the repository:

- ``python -m bench --out DIR``: the paper's claims, as a report; ``bench.readme`` puts its table into the docs
- ``python -m bench.measured``: the pages under "Measured", from what follows here, and the README's table
- ``bench.user_tasks``, ``bench.peers``: beside OpenCV, Open3D and PCL
- ``bench.first_call``, ``bench.batch_throughput``, ``bench.roofline``: where the time goes
- ``bench.real_sensors``, ``bench.uncertainty``: how right planes and their uncertainties are
- ``bench.limits``: where uncertainties are wrong, and by how much
- ``bench.segmentation``: how right, and how fast, the planes of scenes are
- ``bench.repeatability``: whether planes are there in the next frame, and which are false
- ``bench.primitives``: whether balls and pipes are found as such, and how right their radii are
- ``bench.tracking``: whether planes keep their ids
- ``bench.chi_square``: fits the constants of a kernel
- ``bench.pictures``: the pictures of the documentation
- ``pytest bench``: times of single calls
"""
