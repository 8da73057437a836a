"""Messages, their wire form, the bus that carries them and the sessions that keep them.

Read `messages` (what is said; `fields` is what a message is), `codec` (its bytes), `topics` (where
it travels), `zenoh_bus` (how), `session` (what is kept), `session_read` and `container`.
"""
