"""Imports: csv files and ROS bags of other systems become sessions, through a map."""
