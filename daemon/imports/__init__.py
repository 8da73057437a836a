"""Other people's logs as sessions: csv files and ROS bags, through a map."""
