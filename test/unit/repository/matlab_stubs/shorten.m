function path = shorten(planner, path, iterations)
end
