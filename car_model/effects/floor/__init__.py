"""Effects of the floor: slope and places or times of less grip."""
