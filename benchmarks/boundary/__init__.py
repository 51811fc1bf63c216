"""What jumps cost, and how noisy they are, beside Mitsuba's projective sampling."""
