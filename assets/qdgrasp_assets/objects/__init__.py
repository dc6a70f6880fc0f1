"""The built-in objects: stand-ins of our own for ten YCB objects, built in code from convex parts.

Each lies in the frame of the scanned mesh of the same name and has its centre of mass (the inertial origin
of the reference data), so that the same pose means the same grasp. Masses are those published with the YCB
set (Calli et al. 2015, table of object properties), and so are sizes where that table has them along the
axes: the scans differ from them by a few millimetres, the scanned cracker box by 17 mm in height. Banana,
power drill, spatula and the outlines of the bottle follow the scans.
"""
