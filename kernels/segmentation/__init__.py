"""Planes of a frame: a folder a stage, in this order.

- `blocks`: the frame becomes blocks of 4 x 4 pixels, and squares of blocks
- `noise`: what the frame shows of its noise
- `merge` and `assign`, in rounds: regions are made of blocks, pixels go to regions
- `curved`: regions that are no planes
- `components`: regions become connected parts, parts become labels
- `refit`: the final planes, from interior pixels
- `evidence`: which of them are more than noise makes

`rgbd_planes.segmentation` calls them, one kernel a step. A stage uses `model`, never another stage.
"""
