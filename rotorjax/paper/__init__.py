"""The paper's tables as data, and ours beside them: Huang, Pham, Nguyen, Chiu, Sensors 2026, 26, 2565."""
