# Texts of robot.js and what it is made of.
robot-title = Robot
robot-lead = Où se trouve la cellule dans les coordonnées du robot ? Vous touchez quelques points que les caméras voient, ou vous allez à quelques poses, et saisissez ce que le robot affiche. Après chacun, cette page dit ce que vaut le recalage.
robot-no-rig = Il n’y a pas encore de calibrage : calibrez d’abord.
robot-is-fixed = La cellule donne ses résultats dans les coordonnées du robot.
robot-is-flange = Le robot porte les caméras, et la cellule sait comment.
robot-is-none = Pas encore recalé : les résultats sont dans les coordonnées des caméras.
robot-is-unknown = Pas encore connu : la cellule n’a aucune tâche avec laquelle mesurer.
robot-stale = Le calibrage de la cellule a changé depuis le début de ce recalage. Commencez-en un autre.
robot-how = Comment voulez-vous procéder ?
robot-mount = Où sont les caméras ?
robot-mount-fixed = Fixes, à côté ou au-dessus du robot
robot-mount-flange = Sur le robot
robot-way = Comment le robot dit-il où il est ?
robot-way-touch = Sa pointe touche six points. Le TCP de la pointe doit être connu avec précision.
robot-way-poses = Il tient une mire dans dix poses. Rien n’est touché, et aucun TCP n’est nécessaire.
robot-what-touch = Que touche la pointe ?
robot-what-held = Quelle mire la bride tient-elle ?
robot-what-lies = Quelle mire est posée devant les caméras ?
robot-what-part = Une pièce : { $job }
robot-what-board = Une autre mire
robot-brand = Robot
robot-brand-unknown = Je ne sais pas comment il écrit ses poses
robot-begin = Commencer
robot-program = Le programme du robot peut faire tout cela seul, avec quelques commandes à la cellule.
robot-program-later = Tant qu’une personne a la cellule, elle ne prend aucune commande du robot ou de l’automate : rendez-la, puis lancez ce programme. Ses poses ou ses points apparaissent ici à mesure.
robot-program-how = Comment faire
robot-walks = Le programme du robot est en train de recaler la cellule : ses poses ou ses points apparaissent ici à mesure.
robot-walked = Le programme du robot a pris ceux-ci.
robot-new = En commencer un autre
robot-begun-touch = Points touchés
robot-begun-poses = Poses de la bride
robot-begun-samples =
    { $samples ->
        [one] un jusqu’ici
       *[other] { $samples } jusqu’ici
    }
robot-discard-what = Tous ses points et toutes ses poses seront perdus. Un recalage en service reste.
robot-take-cell = Prenez la cellule : ses caméras sont nécessaires.
robot-taking = L’image est en cours de prise …
robot-name-point = point { $number }
robot-name-pose = pose { $number }

## Touching
robot-touch-title = Point { $number } sur { $wanted }
robot-touch-what = Posez la mire ou la pièce, écartez le robot, et prenez une image. Laissez-la ensuite où elle est, et touchez le point sous le réticule.
robot-look = En prendre une image
robot-look-again = Elle a bougé : prendre une nouvelle image
robot-live = Images en direct
robot-look-none = Rien à toucher n’a été trouvé sur cette image.
robot-look-length = D’après ce calibrage, la mire est plus longue de { $percent } % qu’indiqué. Mesurez ses cases : soit la taille saisie ici est fausse, soit celle indiquée au calibrage ; dans ce cas calibrez à nouveau.
robot-look-wrong = La mire n’a pas la longueur indiquée.
robot-look-found = Trouvé : { $count } points.
robot-picture = L’image prise. Son réticule est sur le point choisi ci-dessous.
robot-place = Point (celui qui est proposé aide le plus)
robot-place-mark = repère de la ligne { $row } sur 3, colonne { $column } sur 3
robot-place-circle = centre du cercle { $name }
robot-place-slot = centre du trou oblong { $name }
robot-place-corner = coin { $name }
robot-place-reference = point de référence de la pièce
robot-touched = touché
robot-touch-now = La pointe est exactement au point sous le réticule. Que montre le robot ?
robot-add = Ajouter ce point
robot-point-taken = Ajouté. { $count } points.

## Poses
robot-pose-title = Pose { $number } sur { $wanted }
robot-pose-fixed = La bride tient la mire : amenez-la où les deux caméras voient toute la mire, inclinée et tournée autrement qu’avant. Restez immobile.
robot-pose-flange = La mire est posée : amenez les caméras où les deux la voient entièrement, inclinées et tournées autrement qu’avant. Restez immobile.
robot-pose-take = Prendre l’image à cette pose
robot-pose-taken = { $name } est prise.
robot-pose-unseen = { $name } : la mire n’a pas été assez bien vue.
robot-bare = { $count } des images attendent encore ce que le robot affichait là : saisissez-le dans la liste ci-dessous, ou collez plusieurs lignes à la fois.

## What the robot shows
robot-shown = Ce que le robot affiche
robot-paste = ou collez-le ici, sous n’importe quelle forme : tabulations, virgules, crochets, signes de degré
robot-clear = Effacer
robot-spread = Donner { $count } lignes aux images qui attendent
robot-stage-shows = Scène : ce que montre le robot virtuel
robot-stage-walk = Scène : robot à sa pose suivante

## What they say
robot-verdict = Ce qu’ils disent
robot-judging = (vérification …)
robot-good = Tous concordent.
robot-sigma = Un point parmi eux, dans les coordonnées du robot (1 σ)
robot-held-out = Plus grand écart à l’endroit où tous les autres l’attendent
robot-held-rms = Écart à l’endroit où tous les autres les attendent, sur la mire (rms)
robot-limit = { $mm } mm (limite { $limit } mm)
robot-um = ± { $um } µm
robot-mm = { $mm } mm
robot-more = En ajouter un
robot-scale = Longueurs du robot rapportées à celles des caméras (devrait être 1)
robot-trouble-too-few = { $count } jusqu’ici, il en faut au moins { $least }.
robot-trouble-no-brand = De quelle marque est le robot ? Choisissez-la ci-dessus ; ce qui convient le mieux est montré ci-dessous.
robot-trouble-culprit = { $name } est faux de { $mm } mm : sans lui les autres concordent à { $others } mm. Touchez-le à nouveau, ou corrigez la saisie.
robot-trouble-scale = Les longueurs du robot diffèrent de celles des caméras de { $percent } % (± { $sigma } %). Mesurez les cases de la mire de calibrage : la taille indiquée est fausse, ou le TCP l’est.
robot-trouble-disagree = Ils diffèrent de { $mm } mm, la limite est { $limit } mm, et aucun n’est seul en cause. Prenez-en d’autres, avec soin.
robot-trouble-other-reading = Ces nombres se lisent comme { $reading }, longueurs en { $unit }, caméras { $mounted } : c’est { $whose }. Vous avez dit { $said }. Lus ainsi, ils concordent à { $mm } mm.
robot-trouble-on-one-line = Les points sont sur une droite : la rotation autour d’elle est inconnue. Touchez un point à côté.
robot-trouble-same-place = { $one } et { $two } sont presque au même endroit. Écartez l’un des deux, et touchez-en un autre.
robot-trouble-turns-missing = Les poses ne tournent pas assez : voyez la sphère ci-dessous.
robot-trouble-other-units = Ces longueurs semblent être en { $unit } : une autre unité que celle du pupitre de ce robot. Est-ce le bon robot ?
robot-trouble-mirrored = Les points sont en miroir : un axe a le mauvais signe, ou deux sont intervertis.
robot-trouble-calibration = Il n’y a pas de solution avec ceux-ci : { $detail }
robot-trouble-refused = Pas de verdict maintenant : { $detail }
robot-nobodys = l’usage d’aucun robot
robot-read-so = Les lire comme { $brand }
robot-advice-more = Plus il y en a, meilleur est le résultat et plus les fautes se voient : six points ou dix poses sont bien.
robot-advice-flat = Tous les points sont dans un plan. Placez la mire ou la pièce plus haut pour les suivants : un axe inversé se voit alors aussi.
robot-advice-all = Tournez la bride entre les poses : inclinez-la de 15° vers différents côtés, et tournez le poignet.
robot-advice-tilt = La bride n’a tourné qu’autour de son axe. Inclinez-la de 15° vers différents côtés.
robot-advice-wrist = La bride n’a basculé que d’avant en arrière. Inclinez-la aussi vers les autres côtés, ou tournez le poignet de 30°.
robot-conventions = Comment lire ces nombres, le meilleur en premier
robot-reading = Orientation
robot-lengths = Longueurs
robot-cameras = Caméras
robot-off = Écart
robot-mounted-fixed = fixes
robot-mounted-flange = portées
robot-reading-vector-rad = un vecteur de rotation en rad
robot-reading-vector-deg = un vecteur de rotation en degrés
robot-reading-zyx-deg = des angles autour de Z, du nouvel Y, du nouvel X, en degrés
robot-reading-zyx-rad = des angles autour de Z, du nouvel Y, du nouvel X, en rad
robot-reading-fixed-deg = des angles autour des axes fixes X, Y, Z, en degrés
robot-reading-fixed-rad = des angles autour des axes fixes X, Y, Z, en rad
robot-reading-moving-deg = des angles autour de X, du nouvel Y, du nouvel Z, en degrés
robot-reading-moving-rad = des angles autour de X, du nouvel Y, du nouvel Z, en rad
robot-reading-oat-deg = des angles O, A, T en degrés
robot-reading-oat-rad = des angles O, A, T en rad
robot-reading-scalar-first = un quaternion, partie scalaire en premier
robot-reading-scalar-last = un quaternion, partie scalaire en dernier
robot-sky = Comment la bride a tourné
robot-sky-what = { $count } poses, vues de la première.
robot-sky-whole = Elle a tourné autour de différents axes : bien.
robot-sky-all = Elle a à peine tourné : les flèches montrent comment.
robot-sky-tilt = Elle n’a tourné qu’autour de son axe : les flèches montrent où l’incliner.
robot-sky-wrist = Elle n’a basculé que d’avant en arrière : la flèche montre la rotation du poignet qui manque.
robot-sky-one = { $name } : inclinée de { $tilt }°, tournée de { $turn }°
robot-sky-hint = Chaque numéro est une pose, aussi loin du centre que la bride était inclinée ; son aiguille montre la rotation du poignet.

## The list
robot-samples = Points et poses ({ $count })
robot-samples-touch = Le chiffre est l’écart à l’endroit où tous les autres points attendent celui-ci ; le trait est la limite. Les points voisins d’un faux peuvent aussi avoir de grands chiffres : le faux est nommé.
robot-samples-poses = Le chiffre est l’écart, sur la mire, à l’endroit où toutes les autres poses l’attendent ; le trait est la limite.
robot-why-culprit = Faux, si les autres sont justes.
robot-why-left-out = Écarté à la main.
robot-why-not-seen = La mire n’a pas été assez bien vue.
robot-why-length = Longueur autre qu’indiquée.
robot-why-no-numbers = Que montrait le robot ?
robot-why-misfit = Pas autant de nombres que ce robot en affiche.
robot-why-outlier = Ne va pas avec les autres, et ne compte pas.
robot-edit = Saisir
robot-edit-name = Saisir ce que le robot montrait à { $name }
robot-remove = Écarter
robot-remove-name = Écarter { $name }
robot-restore = Réutiliser
robot-restore-name = Réutiliser { $name }
robot-write = Enregistrer
robot-undo = Annuler
robot-redo = Rétablir
robot-undone = Annulé.
robot-redone = Rétabli.

## Keeping it
robot-keep = Le garder
robot-keep-what = Il est gardé à côté du calibrage, puis vérifié par un toucher de plus. Rien ne change encore dans la cellule.
robot-solve = Garder ce recalage
robot-go = La vérification : allez à ce point
robot-go-look = Posez la mire ou une pièce devant les caméras et prenez une image : vous voyez alors ici où le robot doit aller.
robot-go-flange = La mire est là où elle était à la dernière pose.
robot-go-there = { $place }, dans les coordonnées du robot :
robot-go-slow = Lentement, d’abord 50 mm au-dessus. Puis touchez le point à l’œil, et saisissez ce que le robot affiche.
robot-confirm = De combien était-ce à côté ?
robot-off-by = À côté de { $mm } mm.
robot-off-more = C’est beaucoup : touchez plus de points, ou vérifiez le TCP.
robot-activate = Utiliser ce recalage
robot-activate-title = Utiliser ce recalage ?
robot-note =
    { $brand }, { $count ->
        [one] { $count } échantillon
       *[other] { $count } échantillons
    }
robot-activate-what = La cellule donne dès lors tous les résultats dans les coordonnées du robot. Cela devient une version ; on y revient d’un geste sur la page Système.
robot-activated = En service, version { $number }.
robot-active = En service.

## La carte de l'erreur du robot
robot-map = Carte de l'erreur du robot
robot-map-what = Chaque point donné au robot est décalé selon cette carte. Les pièces hors des points palpés sont refusées. La carte va avec ce recalage : un nouveau recalage la supprime.
robot-map-points = Points palpés
robot-map-degree = { $count }, carte de degré { $degree }
robot-map-left-out = Écart d'un point laissé de côté (rms)
robot-map-from-to = { $held } ; sans la carte { $alone }
robot-map-noise = Ce que la carte ne dit pas (1 σ)
robot-map-hull = Ils couvrent
robot-map-picture = Les points vus du dessus. Chaque trait montre où le robot se trouvait en réalité, { $times } fois trop long ; le plus long fait { $um } µm.
robot-um-plain = { $um } µm
