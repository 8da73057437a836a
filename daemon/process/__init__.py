"""The processes of a run: core, guardian, recorder, gateway, viewer, and who starts them."""
