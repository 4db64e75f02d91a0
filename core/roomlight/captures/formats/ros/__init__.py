"""Bags of ROS: the reader (`bag`), its images and cameras (`images`), and frames of reference (`transform_tree`)."""
