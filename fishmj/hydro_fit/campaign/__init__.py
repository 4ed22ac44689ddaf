"""The campaign: movements of a fish in the flow solver, drawn, run, kept. What every simpler water is fitted to."""
