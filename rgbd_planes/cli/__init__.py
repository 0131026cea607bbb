"""The commands of ``rgbd-planes``, one file each; `rgbd_planes.cli.main` runs them.

A command is a function that declares its arguments on the parser it is given and returns a function that runs it. Its
docstring is its help. It imports what it needs when it runs, so that ``--help`` is instant.
"""

from rgbd_planes.cli.batch import batch
from rgbd_planes.cli.curvature import curvature
from rgbd_planes.cli.demo import demo
from rgbd_planes.cli.fit import fit
from rgbd_planes.cli.noise import noise
from rgbd_planes.cli.normals import normals
from rgbd_planes.cli.odometry import odometry
from rgbd_planes.cli.segment import segment
from rgbd_planes.cli.view import view

COMMANDS = (demo, fit, segment, normals, curvature, noise, odometry, batch, view)
