"""The method of the IROS 2023 paper and other baselines, for comparison; torch lives here."""
