"""Motion capture in: NatNet, VRPN and an external pose topic, to time-stamped planar poses.

The way of a `Pose` (`source`)::

    sockets -> natnet_client | vrpn_client | zenoh_pose -> ingest: timing, frame, gates

Everything but `sockets` is free of I/O and clocks. The wire modules (`natnet`, `vrpn`) encode as
well as decode, so the simulator speaks through the same definitions.
"""
