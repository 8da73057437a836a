"""Messages, their wire form, the bus that carries them and the sessions that keep them.

Start at :mod:`steer_bus.messages` (what is said), :mod:`steer_bus.topics` (where), then
:mod:`steer_bus.codec`, :mod:`steer_bus.bus` and :mod:`steer_bus.session`.
"""
