"""The fit of the water: data sets, records, the fit itself (fit/), its judges and its report."""
