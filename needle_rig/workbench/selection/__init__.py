"""Which effect is missing: screening, search, rivals, lack of fit, the verdict, the deciding experiment."""
