"""The compiled car: from recorded equations to vectorised machine code."""
