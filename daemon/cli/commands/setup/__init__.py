"""Commands for the car, the room and the machine before a drive."""
