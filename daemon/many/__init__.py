"""Many drives or sessions: workers, a journal that lets them go on, the table at the end."""
