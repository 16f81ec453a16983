function cancelGoal(client)
  printf('cancels %s\n', client.ActionName);
end
