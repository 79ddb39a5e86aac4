"""Plans of a ball plate: order, layout, effort, and what an order would not see."""
