"""Other systems' descriptions of a camera, turned into the arguments of `Camera`.

`systems` takes the objects and mappings of OpenCV, ROS, Open3D and RealSense; `files` the files of these and of other
tools, by their contents; `yaml_subset` what calibrations use of YAML.
"""
