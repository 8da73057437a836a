"""Messages, their wire form, the bus that carries them and the sessions that keep them.

Start at `steerd.steer_bus.messages` (what is said), `steerd.steer_bus.topics` (where),
then
`steerd.steer_bus.codec`, `steerd.steer_bus.bus` and `steerd.steer_bus.session`.
"""
