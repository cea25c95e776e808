"""The paper's study: its experiments, claims and figures."""
