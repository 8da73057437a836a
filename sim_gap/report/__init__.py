"""The diagnosis for people and programs: sentences, figures, page, JSON."""
