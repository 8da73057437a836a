"""Many drives of the closed loop in virtual time, each with its own draw of what is uncertain."""
