"""A robot that is not ours: two action servers of types that are not ours, for the path of somebody who has such a robot."""
