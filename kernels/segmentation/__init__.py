"""Planes of a frame: a folder a stage, in this order.

- `blocks`: the frame becomes blocks of 4 x 4 pixels, and squares of blocks
- `noise`: what the frame shows of its noise
- `merge` and `assign`, in rounds: regions are made of blocks, pixels go to regions
- `curved`: regions that are no planes
- `components`: regions become connected parts, parts become labels
- `refit`: the final planes, from interior pixels
- `evidence`: which of them are more than noise makes

`rgbd_planes.segmentation` calls them, one kernel a step. A stage uses `model`, never another stage.

The words:

========================  ============================================================================================
block                     4 x 4 pixels
square                    2 x 2, 4 x 4 or 8 x 8 blocks; the pyramid holds blocks and squares
moments                   the ten sums over pixels from which the plane of any union follows
region                    blocks, and later pixels, that one plane fits; numbered anew in each round
round                     merging neighbours, then assigning every pixel
seed growing              joining neighbours that are one plane beyond doubt, before the rounds
contact                   a pair of regions that touch, and where
owner, share              the region that has a whole block; the pixels that a region has of a mixed block
whole block               a block that goes to its region without a look at its pixels
contested block           a block for whose pixels several regions contend
deviation                 standard deviation of a pixel about a plane: the sensor's noise, and what the slope adds
slope                     change of inverse depth from pixel to pixel
lateral error             where within itself a pixel sees its surface
waviness                  how much larger noise is over a region than over 8 x 8 pixels, as neighbours share errors
correlation length        pixels over which an error reaches
tolerance                 share of the usual allowance for bends, by what the frame shows of its noise
bend, jump                what joining two regions costs per pixel; the step between their planes where they touch
spread                    what joining two regions may cost in any case, in variances
face                      a part of a region that is a plane of its own, and meets another in an edge
quadric                   the second-order surface that fits a region: bent regions prefer it to planes
crease                    an edge within a region, on both sides of which there is a plane
facet                     one of the planes of something that is meant to be round
run                       pixels side by side in a row that one region has; parts are made of runs
part                      a connected component of a region
occlusion gap             what something thin in front hides between two parts of one plane
rim outliers              connected pixels at the rim of a plane whose residuals have one sign: a face too small to see
stray                     a pixel of a small part, or by itself: it takes the label of those around it
interior                  pixels all of whose neighbours have the same label: the final planes are fitted to them
========================  ============================================================================================
"""
